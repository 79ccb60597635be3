"""Small benches whose captures are simulated, with everything known about them."""

import numpy as np
import torch

from warp_caustics import CausticSimulator
from warp_caustics.calibration.flat_light import flat_light
from warp_caustics.calibration.view import View, enlarged_camera, enlarged_scene
from warp_caustics.camera.config import CameraConfig
from warp_caustics.camera.operator import Camera
from warp_caustics.camera.parameters import camera_parameters
from warp_caustics.scene import Scene

PIXELS, PHOTONS = 40, 330
SCENE = Scene(
    height_samples=32, image_pixels=PIXELS, wavelengths_m=(530e-9,), radiosity_W_m2=(1.0,),
    screen_position_m=(0, 0, -3e-3), lamp_half_angle_rad=8e-3,
)  # fmt: skip
CAMERA = CameraConfig(psf_px=0.7, ambient=0.02)
NAMES = (
    "gap_m", "tilt_x_rad", "lamp_half_angle_rad", "shift_x_px", "shift_y_px", "magnification", "psf_px", "ambient",
)  # fmt: skip


def capture(scene, camera, plate, noise, seed, *, name="plate", is_divided=True, photons=PHOTONS, modes=()):
    """What a bench would give: the plate's light through the camera, divided by the flat frame's, with noise."""
    # Pixels four times as fine, which the camera's are means of: pictures that are moved keep what lies between pixels.
    fine, eye = enlarged_scene(scene, 1 / 4), enlarged_camera(camera, 1 / 4)
    heights, changes = plate.surface(fine)
    for value, change in zip(modes, changes, strict=False):
        heights = heights + value * change
    simulator = CausticSimulator(fine, dtype=torch.float64, n_photons=photons**2)
    lens = Camera(eye, fine, dtype=torch.float64)
    image = lens(simulator(heights))
    if is_divided:
        level = torch.tensor(scene.radiosity_W_m2, dtype=torch.float64)[:, None, None]
        image = level * image / lens(flat_light(fine, fine.image_pixels))
    m = scene.image_pixels
    image = image.reshape(len(image), m, 4, m, 4).mean((2, 4))
    drawn = np.random.default_rng(seed).standard_normal(image.shape)
    seen = image.numpy() + noise * np.sqrt(0.3 + 0.7 * np.maximum(image.numpy(), 0)) * drawn
    return View(name, plate, seen, np.full(len(seen), max(noise, 1e-4)), is_divided=is_divided)


def true_values(result, scene, camera):
    """Values of a calibration's parameters in the bench that the captures were made on."""
    parameters = camera_parameters(camera, scene.n_wavelengths, scene.image_pixels, dtype=torch.float64)
    return result.setup.theta(scene, parameters)


def drawn_bench(setup, seed):
    """A bench from the priors: scene, camera and values."""
    generator = np.random.default_rng(seed)
    values = []
    for parameter, nominal in zip(setup.parameters, setup.nominal.tolist(), strict=True):
        value = generator.normal(nominal, parameter.prior)
        values.append(min(max(value, parameter.low), parameter.high))
    theta = torch.tensor(values, dtype=torch.float64)
    from warp_caustics.calibration.window_camera import camera_record

    return setup.scene(theta), camera_record(setup.camera_config, setup.camera(theta)), theta
