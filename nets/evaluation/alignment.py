"""Errors of a relief that lies beside its place: a shifted image and a shifted plate look the same."""

import numpy as np
import scipy.ndimage
import scipy.optimize

from warp_caustics.types import FloatArray

FARTHEST = 2.0
"""Samples by which a relief is moved at most to align it."""


def aligned_rmse_um(heights: FloatArray, true: FloatArray) -> float:
    """Root mean square difference after the best move sideways [um]; heights [m], both of shape [n, n]."""
    margin = 16
    # Filtered once, moved many times; the margin keeps the spline's ends away.
    spline = scipy.ndimage.spline_filter(np.pad(heights, margin, mode="edge"), order=3)
    inside = slice(margin, -margin)

    def error(shift: FloatArray) -> float:
        moved = scipy.ndimage.shift(spline, shift, order=3, mode="nearest", prefilter=False)[inside, inside]
        return 1e6 * float(np.sqrt(np.mean((moved - true) ** 2)))

    found = scipy.optimize.minimize(
        error,
        np.zeros(2),
        method="Nelder-Mead",
        bounds=[(-FARTHEST, FARTHEST)] * 2,
        options={"xatol": 2e-3, "fatol": 1e-3, "initial_simplex": [(0, 0), (0.3, 0), (0, 0.3)]},
    )
    return float(found.fun)
