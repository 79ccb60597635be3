"""From height samples to spline coefficients on a GPU: products with a matrix that is nearly zero off its diagonal.

One thread for each number; neighbouring threads read neighbouring numbers, along both axes.
"""

from types import SimpleNamespace
from typing import Any, no_type_check

import warp as wp

from warp_caustics.kernels.made_once import made_once


@made_once
def prefilter_kernels(dtype: Any) -> SimpleNamespace:
    """Kernels for float32 or float64: ``filter_columns``, then ``filter_rows``.

    Entries farther than ``reach`` from the diagonal are taken as zero. That of a matrix with more rows than columns, or
    fewer, begins and ends beside its corners, by half of the difference.
    """

    @no_type_check
    @wp.kernel(enable_backward=False, module="unique")
    def filter_columns(
        matrix: wp.array2d[dtype],
        planes: wp.array3d[dtype],
        reach: wp.int32,
        least: dtype,
        most: dtype,
        # outputs
        filtered: wp.array3d[dtype],
    ):
        """matrix [R, K] @ planes [B, K, L], all brought between ``least`` and ``most``: what is no number, too."""
        b, i, j = wp.tid()
        middle = i + (planes.shape[1] - matrix.shape[0]) / 2
        total = dtype(0.0)
        for k in range(wp.max(middle - reach, 0), wp.min(middle + reach + 1, planes.shape[1])):
            at = planes[b, k, j]
            # What is no number is not above anything.
            if not at > least:
                at = least
            if at > most:
                at = most
            total += matrix[i, k] * at
        filtered[b, i, j] = total

    @no_type_check
    @wp.kernel(enable_backward=False, module="unique")
    def filter_rows(
        planes: wp.array3d[dtype],
        transposed: wp.array2d[dtype],
        reach: wp.int32,
        # outputs
        filtered: wp.array3d[dtype],
    ):
        """planes [B, R, K] @ transposed [K, C]."""
        b, i, j = wp.tid()
        middle = j + (planes.shape[2] - transposed.shape[1]) / 2
        total = dtype(0.0)
        for k in range(wp.max(middle - reach, 0), wp.min(middle + reach + 1, planes.shape[2])):
            total += planes[b, i, k] * transposed[k, j]
        filtered[b, i, j] = total

    return SimpleNamespace(filter_columns=filter_columns, filter_rows=filter_rows)
