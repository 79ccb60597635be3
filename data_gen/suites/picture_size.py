"""Pictures that are larger or smaller than the window, as a camera's pixels see them: means over other areas.

A picture that is resampled would do: pixels hold what is finer than they are folded into themselves, and no resampling
makes the means over some areas of the means over others.
"""

import numpy as np
import scipy  # loads its parts when they are first used

from warp_caustics.types import FloatArray

FINENESS = 8
"""Fine pixels along a pixel: 0.2 % of flat light off on a plate of three lines."""
LEAST_COVER = 0.5
"""Of a pixel that the picture covers, below which it is as bright as a flat plate."""


def means_of_picture(light: FloatArray, pixels: int, size: float) -> FloatArray:
    """One channel's means over m pixels, shape [m, m], of a picture ``size`` times as large about its middle.

    Irradiance stays, as a flat frame sees to, at the border of a smaller picture, too.

    Args:
        light: on fine pixels of the window, shape [k m, k m], relative to a flat plate's.
        pixels: m.
        size: of the picture over the window.
    """
    fine = light.shape[-1]
    borders = np.clip(((np.arange(pixels + 1) - pixels / 2) / size + pixels / 2) * (fine / pixels), 0, fine)
    sums = np.asarray(light, np.float64)
    for axis in (0, 1):
        whole = np.concatenate([np.zeros_like(sums.take([0], axis)), sums.cumsum(axis)], axis)
        along = scipy.interpolate.CubicSpline(np.arange(fine + 1), whole, axis=axis)
        sums = np.diff(along(borders), axis=axis)
    cover = np.outer(np.diff(borders), np.diff(borders))
    full = (fine / pixels / size) ** 2
    found: FloatArray = np.where(cover >= LEAST_COVER * full, sums / np.maximum(cover, LEAST_COVER * full), 1.0)
    return found
