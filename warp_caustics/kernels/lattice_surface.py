"""Adjoint of a photon lattice's surface maps: every spline coefficient gathers from the photons it acts on.

A lattice is a product of two axes, so the sum over its photons goes along one axis after the other: first across rows,
where neighbouring threads read neighbouring photons. No atomics: the same sums every time, and no matrix with zeros in
all but four of its columns.
"""

from types import SimpleNamespace
from typing import Any, no_type_check

import warp as wp

from warp_caustics.kernels.made_once import made_once


@made_once
def lattice_adjoint_kernels(dtype: Any) -> SimpleNamespace:
    """Kernels for float32 or float64: ``gather_along_y``, then ``gather_along_x``.

    Of each axis of N photons they are told ``first`` [N], the first of the four coefficients that act on a photon;
    ``weights`` [3, N, 4], those of the spline and its two derivatives; and of each coefficient the photons it acts on,
    from the first of ``span`` [2, n + 4] to before the second.
    """
    zero = wp.constant(dtype(0.0))

    @no_type_check
    @wp.kernel(enable_backward=False, module="unique")
    def gather_along_y(
        grad_maps: wp.array4d[dtype],
        first: wp.array[wp.int32],
        span: wp.array2d[wp.int32],
        weights: wp.array3d[dtype],
        first_row: wp.int32,
        # outputs
        sums: wp.array4d[dtype],
    ):
        """From gradients of the maps [B, 6, rows, columns] to sums [B, 3, n + 4, columns], by derivatives along x.

        Of rows from ``first_row`` of the lattice on.
        """
        b, k, j = wp.tid()
        plain = zero
        steep = zero
        bent = zero
        last_row = wp.min(span[1, k], first_row + grad_maps.shape[2])
        for i in range(wp.max(span[0, k], first_row), last_row):
            tap = k - first[i]
            w = weights[0, i, tap]
            s = weights[1, i, tap]
            row = i - first_row
            # MAP_NAMES: h, h_x, h_y, h_xx, h_xy, h_yy
            plain += w * grad_maps[b, 0, row, j] + s * grad_maps[b, 2, row, j]
            plain += weights[2, i, tap] * grad_maps[b, 5, row, j]
            steep += w * grad_maps[b, 1, row, j] + s * grad_maps[b, 4, row, j]
            bent += w * grad_maps[b, 3, row, j]
        sums[b, 0, k, j] = plain
        sums[b, 1, k, j] = steep
        sums[b, 2, k, j] = bent

    @no_type_check
    @wp.kernel(enable_backward=False, module="unique")
    def gather_along_x(
        sums: wp.array4d[dtype],
        first: wp.array[wp.int32],
        span: wp.array2d[wp.int32],
        weights: wp.array3d[dtype],
        # outputs
        grad: wp.array3d[dtype],
    ):
        """From these sums to the gradient of the coefficients [B, n + 4, n + 4]."""
        b, i, k = wp.tid()
        total = zero
        for j in range(span[0, k], span[1, k]):
            tap = k - first[j]
            total += weights[0, j, tap] * sums[b, 0, i, j] + weights[1, j, tap] * sums[b, 1, i, j]
            total += weights[2, j, tap] * sums[b, 2, i, j]
        grad[b, i, k] = total

    return SimpleNamespace(gather_along_y=gather_along_y, gather_along_x=gather_along_x)
