"""Grain that neighbouring pixels share, beside white noise, against what was put in."""

import numpy as np
import pytest
from scipy import ndimage

from warp_caustics.io.grain import estimate_grain
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
def test_grain_is_found_beside_noise(white, grain):
    """To an eighth, as the square root of all variance less that of what white noise is taken to be."""
    for seed, level in ((0, 1.0), (1, 500.0)):
        image = picture(seed, white, grain, level)
        noise = estimate_noise_std(image, level)
        expected = np.sqrt(white**2 + grain**2 - (noise / level) ** 2)
        assert estimate_grain(image, level, noise) == pytest.approx(expected, rel=0.15)


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
