"""Medians of 5 x 5 pixels against SciPy's."""

import numpy as np
import pytest
from scipy import ndimage

from warp_caustics.io.median import ROWS, median_5x5


@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (5, 5), (ROWS, 7), (ROWS + 1, 40), (3 * ROWS - 5, 61)])
@pytest.mark.parametrize("decimals", [0, 1, 12])
def test_the_same_as_of_scipy(shape, decimals):
    """Many equal values, some, and none."""
    image = np.round(np.random.default_rng(0).standard_normal(shape), decimals)
    before = image.copy()
    np.testing.assert_array_equal(median_5x5(image), ndimage.median_filter(image, 5))
    np.testing.assert_array_equal(image, before, "what is given is not changed")


def test_every_order_of_zeros_and_ones():
    """A network that is right for these is right for all values. No two windows looked at share a pixel."""
    counts = np.indices((6,) * 5).reshape(5, -1).T
    windows = np.arange(5)[:, None] >= counts[:, None, :]
    image = np.concatenate(list(windows), axis=1).astype(np.float64)
    found = median_5x5(image)[2, 2::5]
    np.testing.assert_array_equal(found, counts.sum(1) <= 12)
    # Sorted columns are all that the network sees; that columns are sorted:
    columns = (np.arange(32)[None, :] >> np.arange(5)[:, None]) & 1
    image = np.repeat(columns, 5, axis=1).astype(np.float64)
    np.testing.assert_array_equal(median_5x5(image)[2, 2::5], columns.sum(0) >= 3)
