"""Means over pixels of pictures of another size, against closed forms."""

import numpy as np
import pytest
import scipy.special

from data_gen.suites.picture_size import FINENESS, means_of_picture

PIXELS = 48


def ridge(pixels, size=1.0, width_px=0.7):
    """Means over pixels of a Gaussian ridge along y of a picture that is larger, beside even light, shape [m, m]."""
    borders = ((np.arange(pixels + 1) - pixels / 2) / size) * (PIXELS / pixels) - 3.3
    whole = width_px * np.sqrt(np.pi / 2) * scipy.special.erf(borders / (width_px * np.sqrt(2)))
    return np.tile(1 + np.diff(whole) / np.diff(borders), (pixels, 1))


@pytest.mark.parametrize("size", [1.0, 1.01, 0.99, 1.002])
def test_a_ridge_that_is_larger(size):
    """To 0.1 %: as if it had been made larger before it met the pixels."""
    found = means_of_picture(ridge(FINENESS * PIXELS), PIXELS, size)
    np.testing.assert_allclose(found, ridge(PIXELS, size), atol=1e-3)
    np.testing.assert_allclose(means_of_picture(ridge(FINENESS * PIXELS).T, PIXELS, size), found.T, atol=1e-12)


def test_even_light_stays_even_at_the_border_of_a_smaller_picture():
    even = np.ones((FINENESS * PIXELS,) * 2)
    np.testing.assert_allclose(means_of_picture(even, PIXELS, 0.95), 1.0, rtol=1e-9)
    np.testing.assert_allclose(means_of_picture(even, PIXELS, 1.05), 1.0, rtol=1e-9)
