"""Photos under a lamp nearby, whose light falls off also behind a flat plate."""

import numpy as np
import pytest
import torch

from warp_caustics import CausticSimulator, Scene
from warp_caustics.capture.near_lamp import light_of_flat_plate
from warp_caustics.capture.radiometric import capture_to_irradiance
from warp_caustics.io.image_file import ImageFile


def scene(distance_m, **fields):
    lamp = {"emission_half_angle_rad": 0.5, "light_position_m": (0.0, 0.0, distance_m)}
    return Scene(image_pixels=64, height_samples=32, **lamp, **fields)


def frame(values):
    return ImageFile(np.asarray(values, np.float32), None, 32, "npy")


@pytest.mark.parametrize("level", [(1.0, 1.0, 1.0), (2.0, 0.5, 0.1)])
def test_photo_over_flat_field_is_the_irradiance_of_the_plate(level):
    bench = scene(0.15, radiosity_W_m2=level)
    bump = torch.zeros(32, 32)
    bump[12:20, 12:20] = 1e-4
    simulator = CausticSimulator(bench, "lattice")
    image, flat = (simulator(heights).numpy() for heights in (bump, torch.zeros(32, 32)))
    vignetting = np.linspace(0.7, 1.0, 64)[None, None]
    found = capture_to_irradiance(frame(500 * vignetting * image), flat=frame(500 * vignetting * flat), scene=bench)
    # The outermost pixels are darker, which the smoothing of a flat field spreads.
    inside = slice(None), slice(20, -20), slice(20, -20)
    np.testing.assert_allclose(found.irradiance[inside], image[inside], rtol=1e-3)
    assert np.abs(image[0] / flat[0] * level[0] - image[0])[20:-20, 20:-20].max() > 0.02 * level[0]
    assert any(stage.name == "lamp nearby" for stage in found.stages)


def test_falloff_is_that_of_a_point_source():
    """Cosine and distance to the lamp, through a plate as thin as the rest of the path is long."""
    bench = scene(0.3, base_thickness_m=1e-4)
    light = light_of_flat_plate(bench)[1]
    along = (np.arange(64) + 0.5) / 64 * 0.05 - 0.025
    x, y = np.meshgrid(along, along)
    depth = 0.3 + 1e-4 / bench.glass_indices[1]  # of the lamp, as seen from behind the glass, about
    expected = (depth**2 / (depth**2 + x**2 + y**2)) ** 1.5
    inside = slice(2, -2)
    np.testing.assert_allclose(
        light[inside, inside] / light[32, 32], (expected / expected[32, 32])[inside, inside], atol=1e-3
    )


def test_collimated_light_is_left_alone():
    bench = Scene(image_pixels=64, height_samples=32)
    flat = np.full((3, 64, 64), 3.0)
    found = capture_to_irradiance(frame(flat), flat=frame(flat), scene=bench)
    np.testing.assert_allclose(found.irradiance, 1.0, rtol=1e-6)
    assert not any(stage.name == "lamp nearby" for stage in found.stages)
