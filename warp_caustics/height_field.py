"""The relief as a surface: cubic B-spline that interpolates the height samples.

Samples sit at the centres of an n x n grid of cells; outside, the outermost
samples continue for ever (edge extension). The spline then equals
``scipy.ndimage`` with ``order=3, mode="nearest"``. It may dip below zero next
to a steep relief.

A point is addressed by its sample coordinate u = (x + W/2) / pitch - 1/2, so
that sample i lies at u = i and the plate spans -1/2 <= u <= n - 1/2. Four
coefficients c[floor(u) - 1 ... floor(u) + 2] act on it, hence two more
coefficients than samples are kept on either side.
"""

import math
from functools import lru_cache

import numpy as np

from warp_caustics.types import FloatArray, IntArray

MARGIN = 2
"""Coefficients kept beyond the samples on either side."""

TAPS = 4
"""Coefficients that act on a point along an axis."""

_POLE = math.sqrt(3.0) - 2.0

PREFILTER_REACH = 40
"""The prefilter decays by 0.27 per sample: at 40 samples, or with 40 of edge extension, 1e-23 is left."""

REACH_OF_BITS = {32: 16, 64: PREFILTER_REACH}
"""Of the prefilter, that kernels look at: all entries beyond 16 samples are 1e-9, which float32 does not show."""


def prefilter_matrix(n: int, first: int = 0, last: int | None = None) -> FloatArray:
    """Matrix from height samples to spline coefficients along one axis, shape [n + 4, n], or some of its rows.

    The inverse of the sampled cubic B-spline (1, 4, 1)/6 has the impulse
    response sqrt(3) z^|k| with z = sqrt(3) - 2 (Unser, IEEE Signal Processing
    Magazine 16(6), 22 (1999), box 2); edge extension folds its tails onto the
    outermost samples.

    Args:
        n: number of samples along the axis.
        first: of these rows.
        last: before which they end; None for all.
    """
    return _prefilter_rows(n, first, last).copy()


@lru_cache(maxsize=16)
def _prefilter_rows(n: int, first: int, last: int | None) -> FloatArray:
    # A search for lines and bench makes simulators by the dozen, of one grid.
    rows = np.arange(n + 2 * MARGIN)[first:last] - MARGIN
    columns = np.arange(rows[0] - PREFILTER_REACH, rows[-1] + PREFILTER_REACH + 1)
    response = math.sqrt(3.0) * _POLE ** np.abs(rows[:, None] - columns[None, :])
    folded = np.zeros((len(rows), n))
    np.add.at(folded.T, np.clip(columns, 0, n - 1), response.T)
    return folded


def basis_taps(n: int, u: FloatArray, derivative: int) -> tuple[IntArray, FloatArray]:
    """The four coefficients that act on the spline, or on its derivative, at given points of one axis.

    Args:
        n: number of samples along the axis.
        u: sample coordinates in [-1/2, n - 1/2], shape [k].
        derivative: 0, 1 or 2; derivatives are per sample pitch.

    Returns:
        The first of them, shape [k], and their weights [k, 4].
    """
    cell = np.clip(np.floor(u).astype(int), -1, n - 1)
    t = u - cell
    if derivative == 0:
        weights = [(1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3]
        weights = [w / 6 for w in weights]
    elif derivative == 1:
        weights = [-((1 - t) ** 2) / 2, (3 * t**2 - 4 * t) / 2, (-3 * t**2 + 2 * t + 1) / 2, t**2 / 2]
    elif derivative == 2:
        weights = [1 - t, 3 * t - 2, -3 * t + 1, t]
    else:
        raise ValueError(f"derivative {derivative} is not 0, 1 or 2")
    return cell + MARGIN - 1, np.stack(weights, axis=-1)


def basis_matrix(n: int, u: FloatArray, derivative: int) -> FloatArray:
    """Matrix from coefficients to the spline, or to its derivative, at given points of one axis.

    Args:
        n: number of samples along the axis.
        u: sample coordinates in [-1/2, n - 1/2], shape [k].
        derivative: 0, 1 or 2; derivatives are per sample pitch.

    Returns:
        Shape [k, n + 4].
    """
    first, weights = basis_taps(n, u, derivative)
    matrix = np.zeros((len(u), n + 2 * MARGIN))
    np.put_along_axis(matrix, first[:, None] + np.arange(TAPS), weights, axis=1)
    return matrix


def cell_centres(n: int, length_m: float) -> FloatArray:
    """Centres of n equal cells that divide an axis of the given length [m], centred on 0; shape [n]."""
    return ((np.arange(n) + 0.5) / n - 0.5) * length_m


def sample_coordinate(position_m: FloatArray, n: int, length_m: float) -> FloatArray:
    """Sample coordinate u of positions [m] along an axis of n samples and the given length [m]."""
    return (position_m / length_m + 0.5) * n - 0.5
