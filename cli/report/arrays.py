"""Arrays as a page holds them: no larger than can be seen, and without what JSON does not know."""

import base64
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from warp_caustics.types import FloatArray

MAP_SAMPLES = 256
"""Longest side of the maps."""

SURFACE_SAMPLES = 160
"""Longest side of the 3D surface: browsers without a GPU still turn it smoothly."""


def reduced(values: "FloatArray", limit: int) -> npt.NDArray[np.float64]:
    """Means of nearly equal blocks, where an array is larger than the limit.

    Values that are not finite are left out; a block without any other is NaN. Block
    edges are whole samples, so that a block sits within half a sample of its place.

    Args:
        values: shape [..., rows, columns].
        limit: of the longer of the last two sides.

    Returns:
        Shape [..., rows', columns'], NaN for what is not finite.
    """
    array = np.asarray(values, dtype=np.float64)
    known = np.isfinite(array)
    total, count = np.where(known, array, 0.0), known.astype(np.float64)
    longest = max(array.shape[-2:])
    if longest > limit:
        for axis in (-2, -1):
            size = array.shape[axis]
            blocks = max(1, round(size * limit / longest))
            edges = np.round(np.linspace(0, size, blocks + 1)).astype(int)[:-1]
            total, count = np.add.reduceat(total, edges, axis=axis), np.add.reduceat(count, edges, axis=axis)
    with np.errstate(invalid="ignore", divide="ignore"):
        means: npt.NDArray[np.float64] = total / count
    return means


def packed(values: "FloatArray") -> dict[str, Any]:
    """A 2D array as little-endian float32 in base64, with its shape; NaN stays NaN."""
    raw = np.ascontiguousarray(values, dtype="<f4")
    return {"shape": list(raw.shape), "f4": base64.b64encode(raw.tobytes()).decode("ascii")}


def finite_range(*arrays: "FloatArray | None") -> tuple[float, float]:
    """Lowest and highest finite value of all arrays; (0, 1) where there is none, never an empty range."""
    values = [array[np.isfinite(array)] for array in arrays if array is not None]
    values = [array for array in values if array.size]
    if not values:
        return 0.0, 1.0
    low, high = float(min(array.min() for array in values)), float(max(array.max() for array in values))
    return (low, high) if high > low else (low, low + (abs(low) or 1.0))
