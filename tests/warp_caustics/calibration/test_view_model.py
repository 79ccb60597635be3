"""Derivatives of what a capture should show: against differences of the model, and its parts against closed forms."""

import numpy as np
import pytest
import torch

from warp_caustics.calibration.flat_light import flat_light
from warp_caustics.calibration.plates import lens
from warp_caustics.calibration.view_model import ViewModel, difference_ends
from warp_caustics.camera.config import CameraConfig
from warp_caustics.scene import Scene
from warp_caustics.setup.set_up import SetUp

SMOOTH = Scene(
    height_samples=16, image_pixels=32, screen_position_m=(0, 0, -2e-3), lamp_half_angle_rad=0.02,
    wavelengths_m=(610e-9, 430e-9), radiosity_W_m2=(1.0, 0.8),
)  # fmt: skip
NAMES = (
    "gap_m", "tilt_x_rad", "vergence_per_m", "lamp_half_angle_rad", "shift_x_px", "shift_y_px", "turn_rad", "magnification",
    "colour_shift_x_px.0", "colour_scale.1", "psf_px", "ambient", "light_x.0", "mixing.0.1",
)  # fmt: skip
CAMERA = CameraConfig(
    psf_px=(1.2, 1.0), shift_px=(0.3, -0.2), turn_rad=4e-3, ambient=0.02, light=(0.02, 0.01, 0.0, 0.0, 0.0),
    mixing=((1.0, 0.05), (0.02, 1.0)),
)  # fmt: skip


def model(is_divided=True):
    setup = SetUp.of(SMOOTH, CAMERA, NAMES)
    heights, modes = lens(0.2, 0.045).surface(SMOOTH)
    heights = heights * 0.5
    return ViewModel(setup, heights, modes, is_divided, n_photons=96**2)


@pytest.mark.parametrize("is_divided", [True, False])
def test_derivatives_are_those_of_the_image(is_divided):
    """Along each number the image changes as its derivative says; by squares where light depends on squares."""
    view = model(is_divided)
    theta = view.setup.nominal.clone()
    theta[NAMES.index("vergence_per_m")] = 0.5
    plate = torch.tensor([0.5, 1e-5, 0.0], dtype=torch.float64)
    _, by_setup, by_plate = view.derivatives(theta, plate)
    inner = (..., slice(4, -4), slice(4, -4))
    steps = {"m": 2e-5, "rad": 2e-4, "1/m": 0.01, "px": 2e-3, "1": 2e-4}
    for k, p in enumerate(view.setup.parameters):
        step = steps[p.unit]
        ahead, behind = theta.clone(), theta.clone()
        ahead[k] += step
        behind[k] -= step
        apart = float(ahead[k] ** 2 - behind[k] ** 2) if p.is_squared else 2 * step
        change = (view.image(ahead, plate) - view.image(behind, plate)) / apart
        off = float((by_setup[k] - change)[inner].norm() / change[inner].norm())
        assert off < (0.06 if p.group in ("turn_rad", "magnification", "colour_scale") else 0.03), (p.name, off)
    for k in range(3):
        step = (1e-2, 1e-5, 1e-5)[k]
        ahead, behind = plate.clone(), plate.clone()
        ahead[k] += step
        behind[k] -= step
        change = (view.image(theta, ahead) - view.image(theta, behind)) / (2 * step)
        assert float((by_plate[k] - change)[inner].norm() / change[inner].norm()) < 0.02


def test_division_takes_uneven_light_away():
    """A flat plate divided by its flat frame is flat, whatever the camera."""
    setup = SetUp.of(SMOOTH, CAMERA, ["gap_m"])
    zero = torch.zeros(16, 16, dtype=torch.float64)
    view = ViewModel(setup, zero, torch.zeros(0, 16, 16, dtype=torch.float64), True, n_photons=64**2)
    shown = view.image(setup.nominal, torch.zeros(0, dtype=torch.float64))[:, 4:-4, 4:-4]
    level = torch.tensor(SMOOTH.radiosity_W_m2, dtype=torch.float64)[:, None, None]
    assert float((shown / level - 1).abs().max()) < 2e-3


def test_flat_light_falls_off_as_a_lamp_does():
    """E(r) / E(0) = (1 + r^2 / L^2)^(-3/2) at a plate in air, L the lamp's distance."""
    lamp = Scene(
        height_samples=16, image_pixels=64, emission_half_angle_rad=0.6, light_position_m=(0, 0, 0.101), glass=1.0001,
        base_thickness_m=1e-3, screen_position_m=(0, 0, -1e-6),
    )  # fmt: skip
    light = flat_light(lamp, 64)[1]
    middle = light[31:33, 31:33].mean()
    radius = float(lamp.pixel_size_m[0]) * 31.5 * np.sqrt(2)
    expected = (1 + (radius / 0.101) ** 2) ** -1.5
    assert float(light[0, 0] / middle) == pytest.approx(expected, rel=5e-3)


def test_difference_ends_stay_within_the_range():
    setup = SetUp.of(SMOOTH, CAMERA, ["vergence_per_m", "psf_px"])
    vergence = setup.parameters[0]
    assert difference_ends(vergence, 0.0, 0.1) == (0.0, 0.1)
    low, high = difference_ends(setup.parameters[1], 0.05, 1.0)
    assert low == 0.0 and high > 0.05
