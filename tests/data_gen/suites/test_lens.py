"""A lens acts before the pixels: on a picture with a known mean over each of them."""

import numpy as np
import pytest
import scipy

from data_gen.suites.lens import FINENESS, behind_lens, lens_moves, through_lens
from warp_caustics.camera.config import CameraConfig, SensorConfig

PIXELS = 24
K = FINENESS


def line_of_light(at_px: float) -> np.ndarray:
    """One fine column of light, at ``at_px`` pixels from the left; 1 in the mean over its pixel, shape [1, k m, k m]."""
    light = np.zeros((1, K * PIXELS, K * PIXELS), np.float32)
    light[0, :, int(at_px * K)] = K
    return light


@pytest.mark.parametrize("width", [0.35, 0.7, 1.2])
@pytest.mark.parametrize("at_px", [12.0, 12.3, 12.75])
def test_a_gaussian_line_behind_a_gaussian_is_differences_of_its_integral(width, at_px):
    own = 0.25
    fine = np.diff(scipy.special.ndtr((np.arange(K * PIXELS + 1) / K - at_px) / own)) * K
    light = np.broadcast_to(fine, (1, K * PIXELS, K * PIXELS)).astype(np.float32)
    found = through_lens(light, CameraConfig(psf_px=width))[0]
    expected = np.diff(scipy.special.ndtr((np.arange(PIXELS + 1) - at_px) / np.hypot(own, width)))
    np.testing.assert_allclose(found[PIXELS // 2], expected, atol=5e-4)
    np.testing.assert_allclose(found.sum(axis=1), 1, rtol=1e-5)


def test_blur_after_the_pixels_is_another():
    """Which of its four quarters a line is in shows in a photo only if the lens comes first."""
    first, last = (through_lens(line_of_light(at), CameraConfig(psf_px=0.7))[0] for at in (12.0, 12.75))
    assert np.abs(first - last).max() > 0.2
    sharp = [through_lens(line_of_light(at), CameraConfig())[0] for at in (12.0, 12.75)]
    np.testing.assert_array_equal(*sharp)


def test_each_wavelength_has_its_own_lens():
    light = np.repeat(line_of_light(12.0), 3, axis=0)
    found = through_lens(light, CameraConfig(psf_px=(0.0, 0.5, 1.0)))
    assert found[0].max() == 1 and found[0].max() > found[1].max() > found[2].max()


def test_screens_move_against_the_picture():
    camera = CameraConfig(shift_px=(0.25, -0.5), colour_shift_px=((0.125, 0.0), (0.0, 0.0), (0.0, 0.25)))
    np.testing.assert_array_equal(lens_moves(camera, 3), [(-0.375, 0.5), (-0.25, 0.5), (-0.25, 0.25)])
    assert not lens_moves(CameraConfig(), 3).any()


def test_nothing_of_the_lens_is_done_twice():
    camera = CameraConfig(
        psf_px=0.7, shift_px=(0.1, 0.2), colour_shift_px=((0.1, 0.0),) * 3, ambient=0.01, sensor=SensorConfig(bits=12)
    )
    assert behind_lens(camera) == CameraConfig(ambient=0.01, sensor=SensorConfig(bits=12))
