"""From height samples to spline coefficients on a GPU: products with a matrix that is nearly zero off its diagonal.

One thread for each number; neighbouring threads read neighbouring numbers, along both axes. Entries farther than
``reach`` from the diagonal are taken as zero. That of a matrix with more rows than columns, or fewer, begins and ends
beside its corners, by half of the difference.
"""

from types import SimpleNamespace
from typing import Any, no_type_check

import warp as wp

from warp_caustics.kernels.made_once import made_once


@made_once
def prefilter_kernels(dtype: Any) -> SimpleNamespace:
    """Kernels for float32 or float64: ``filter_columns``, then ``filter_rows``.

    Of heights that the host has yet to judge ``filter_columns_there``, then ``filter_rows_and_tell``
    (:class:`~warp_caustics.extremes.Extremes`).
    """

    integer = wp.int32 if dtype == wp.float32 else wp.int64
    below = integer(2 ** (31 if dtype == wp.float32 else 63) - 1)

    @no_type_check
    @wp.func
    def ordered(bits: integer):
        """Integers in the order of the numbers whose bits they are, and back: a GPU is quick to take the least."""
        if bits < integer(0):
            return bits ^ below
        return bits

    @no_type_check
    @wp.func
    def filtered_in_column(
        matrix: wp.array2d[dtype],
        planes: wp.array3d[dtype],
        b: wp.int32,
        i: wp.int32,
        j: wp.int32,
        reach: wp.int32,
        least: dtype,
        most: dtype,
    ):
        """One number of matrix @ planes, and the lowest and highest of what it is made of, which may be no numbers."""
        middle = i + (planes.shape[1] - matrix.shape[0]) / 2
        total, lowest, highest = dtype(0.0), dtype(wp.inf), dtype(-wp.inf)
        for k in range(wp.max(middle - reach, 0), wp.min(middle + reach + 1, planes.shape[1])):
            at = planes[b, k, j]
            if at < lowest:
                lowest = at
            if at > highest:
                highest = at
            # What is no number is not above anything.
            if not at > least:
                if wp.isnan(at):
                    lowest, highest = dtype(-wp.inf), dtype(wp.inf)
                at = least
            if at > most:
                at = most
            total += matrix[i, k] * at
        return total, lowest, highest

    @no_type_check
    @wp.func
    def filtered_in_row(
        planes: wp.array3d[dtype],
        transposed: wp.array2d[dtype],
        b: wp.int32,
        i: wp.int32,
        j: wp.int32,
        reach: wp.int32,
    ):
        """One number of planes @ transposed."""
        middle = j + (planes.shape[2] - transposed.shape[1]) / 2
        total = dtype(0.0)
        for k in range(wp.max(middle - reach, 0), wp.min(middle + reach + 1, planes.shape[2])):
            total += planes[b, i, k] * transposed[k, j]
        return total

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
        total, _lowest, _highest = filtered_in_column(matrix, planes, b, i, j, reach, least, most)
        filtered[b, i, j] = total

    @no_type_check
    @wp.kernel(enable_backward=False, module="unique")
    def filter_columns_there(
        matrix: wp.array2d[dtype],
        where: wp.array[wp.uint64],
        reach: wp.int32,
        least: dtype,
        most: dtype,
        # outputs
        filtered: wp.array3d[dtype],
        extremes: wp.array[integer],
    ):
        """The same of planes [B, K, K] at the address ``where[0]``; ``extremes`` become the lowest and highest."""
        b, i, j = wp.tid()
        samples = filtered.shape[2]
        planes = wp.array(ptr=where[0], shape=(filtered.shape[0], samples, samples), dtype=dtype)
        total, lowest, highest = filtered_in_column(matrix, planes, b, i, j, reach, least, most)
        filtered[b, i, j] = total
        # Each of these rows saw all that lie within reach: together they saw every one.
        if i % (2 * reach + 1) == 0 or i == filtered.shape[1] - 1:
            wp.atomic_min(extremes, 0, ordered(wp.cast(lowest, integer)))
            wp.atomic_max(extremes, 1, ordered(wp.cast(highest, integer)))

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
        filtered[b, i, j] = filtered_in_row(planes, transposed, b, i, j, reach)

    @no_type_check
    @wp.kernel(enable_backward=False, module="unique")
    def filter_rows_and_tell(
        planes: wp.array3d[dtype],
        transposed: wp.array2d[dtype],
        reach: wp.int32,
        # outputs
        filtered: wp.array3d[dtype],
        extremes: wp.array[integer],
        told: wp.array[dtype],
    ):
        """The same; ``extremes`` are told to the host, and forgotten."""
        b, i, j = wp.tid()
        filtered[b, i, j] = filtered_in_row(planes, transposed, b, i, j, reach)
        if b == 0 and i == 0 and j == 0:
            told[0] = wp.cast(ordered(extremes[0]), dtype)
            told[1] = wp.cast(ordered(extremes[1]), dtype)
            extremes[0] = ordered(wp.cast(dtype(wp.inf), integer))
            extremes[1] = ordered(wp.cast(dtype(-wp.inf), integer))

    return SimpleNamespace(
        filter_columns=filter_columns,
        filter_columns_there=filter_columns_there,
        filter_rows=filter_rows,
        filter_rows_and_tell=filter_rows_and_tell,
    )
