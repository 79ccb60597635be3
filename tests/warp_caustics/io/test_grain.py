"""Grain that neighbouring pixels share, beside white noise, against what was put in."""

import numpy as np
import pytest
from scipy import ndimage

from warp_caustics.io.grain import BACKGROUND_PX, covariance_left, estimate_grain
from warp_caustics.io.noise import estimate_noise_std

PIXELS = 256


def picture(seed, white, grain, level=1.0, width_px=1.0):
    """A lens of light in the middle of even light, with shot noise and speckle."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:PIXELS, :PIXELS] - PIXELS / 2
    light = 1 + 3 * np.exp(-((np.hypot(x, y) - 40) ** 2) / 18) - 0.4 * np.exp(-(x**2 + y**2) / 2000)
    speckle = ndimage.gaussian_filter(rng.standard_normal(light.shape), width_px)
    seen = light * (1 + grain * speckle / speckle.std()) + white * np.sqrt(light) * rng.standard_normal(light.shape)
    return level * seen


@pytest.mark.parametrize(("white", "grain"), [(0.015, 0.02), (0.03, 0.05), (0.01, 0.03)])
@pytest.mark.parametrize("width_px", [0.8, 1.0, 1.4])
def test_grain_is_found_beside_noise(white, grain, width_px):
    """To an eighth, as the square root of all variance less that of what white noise is taken to be.

    Quiet squares, as they are, have a tenth to a quarter less.
    """
    for seed, level in ((0, 1.0), (1, 500.0)):
        image = picture(seed, white, grain, level, width_px)
        noise = estimate_noise_std(image, level)
        expected = np.sqrt(white**2 + grain**2 - (noise / level) ** 2)
        assert estimate_grain(image, level, noise) == pytest.approx(expected, rel=0.12)


@pytest.mark.parametrize("width_px", [0.7, 1.5, 3.0])
def test_what_a_mean_takes_of_speckle(width_px):
    """Its covariance beside a mean, in closed form, is that of speckle drawn at random."""
    rng = np.random.default_rng(3)
    speckle = ndimage.gaussian_filter(rng.standard_normal((1500, 1500)), width_px, mode="wrap")
    speckle /= speckle.std()
    fine = speckle - ndimage.gaussian_filter(speckle, BACKGROUND_PX, mode="wrap")
    for apart in (0, 1, 2, 3):
        measured = np.mean(fine * np.roll(fine, apart, axis=1))
        assert float(covariance_left(width_px, float(apart))) == pytest.approx(measured, abs=0.02)


def test_faint_relief_in_most_squares_is_no_wide_speckle():
    """Where nearly no square is without relief, quiet ones are not brought to the mean of all: 0.015 of noise and grain.

    Brought to that, they would be 0.03 and more.
    """
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:PIXELS, :PIXELS]
    strength = 0.1 * rng.random((PIXELS // 32, PIXELS // 32)).repeat(32, 0).repeat(32, 1) ** 2
    waves = 1 + strength * np.sin(0.9 * x + 0.5 * y)
    speckle = ndimage.gaussian_filter(rng.standard_normal(waves.shape), 1.0)
    seen = waves * (1 + 0.01 * speckle / speckle.std()) + 0.005 * rng.standard_normal(waves.shape)
    assert estimate_grain(seen, 1.0, 0.005) < 0.015


@pytest.mark.parametrize("white", [0.003, 0.01, 0.1])
def test_white_noise_has_no_grain(white):
    for seed in range(5):
        image = picture(seed, white, 0.0)
        assert estimate_grain(image, 1.0, estimate_noise_std(image, 1.0)) == 0.0


def test_too_little_even_light_tells_nothing():
    image = picture(0, 0.01, 0.05)
    assert estimate_grain(image[:64, :64], 1.0, 0.01) == 0.0
    assert estimate_grain(10 * image, 1.0, 0.01) == 0.0 and estimate_grain(image, 0.0, 0.01) == 0.0
    valid = np.zeros(image.shape, bool)
    assert estimate_grain(image, 1.0, 0.01, valid) == 0.0
