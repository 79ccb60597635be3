"""Soft shrinkage between bounds: the sparsity prior of SfC.

Kassubeck et al., Shape from Caustics, WACV 2021: "extended" because the shrunk value is clamped to [a, b].
"""

import numpy as np

from warp_caustics.types import FloatArray


def soft_shrink(values: FloatArray, threshold: float, lowest: float = -np.inf, highest: float = np.inf) -> FloatArray:
    """clamp(sign(v) max(|v| - threshold, 0), lowest, highest).

    The proximal map of threshold * ||v||_1 (Daubechies, Defrise and De Mol 2004) plus the indicator of
    [lowest, highest] where 0 lies between the bounds.

    Args:
        values: v, any shape and unit.
        threshold: at least 0, unit of v.
        lowest: a, unit of v.
        highest: b, unit of v.

    Returns:
        Shape and unit of v.
    """
    shrunk = np.sign(values) * np.maximum(np.abs(values) - threshold, 0.0)
    clamped: FloatArray = np.clip(shrunk, lowest, highest)
    return clamped
