"""Adjoint of ``gather_surface``: from gradients of scattered photons to those of coefficients.

Sixteen coefficients share what a photon brings. Floating numbers are added in any order of photons; in fixed point the
order does not matter. The threads of a GPU that stand over one cell, as photons sorted by cell do, add up what they
bring first: a cell's coefficients would otherwise wait for hundreds of additions, one after the other.
"""

from typing import Any, no_type_check

import warp as wp

from warp_caustics.kernels.fixed_point import counting_function
from warp_caustics.kernels.made_once import made_once
from warp_caustics.kernels.native import cell_adder
from warp_caustics.kernels.photons import photons_struct
from warp_caustics.kernels.surface import surface_functions


@made_once
def surface_adjoint_kernel(dtype: Any, is_fixed: bool) -> Any:
    """Kernel ``share_gradient`` for float32 or float64, with sums of that type or in fixed point."""
    Photons = photons_struct(dtype)
    functions = surface_functions(dtype)
    cell_at = functions.cell_at
    weights, slopes, curvatures = functions.spline_weights, functions.spline_slopes, functions.spline_curvatures
    counted, sums_type = counting_function(wp.float64, True), wp.int64 if is_fixed else dtype
    add_to_cell = cell_adder(dtype)
    vec16 = wp.types.vector(length=16, dtype=dtype)
    vec3 = wp.types.vector(length=3, dtype=dtype)

    @no_type_check
    @wp.kernel(enable_backward=False, module="unique")
    def share_gradient(
        photons: Photons,
        grad_maps: wp.array3d[dtype],
        steps: wp.array[wp.float64],
        # outputs
        sums: wp.array3d[sums_type],
    ):
        """From gradients of maps [B, 6, N] to those of coefficients [B, n + 4, n + 4]; in fixed point, in ``steps`` [B]
        per unit."""
        b, p = wp.tid()
        along_x = photons.samples_per_m_x
        along_y = photons.samples_per_m_y
        # --- place and weights
        column, row, tx, ty = cell_at(photons.positions[p, 0], photons.positions[p, 1], photons)
        wx = weights(tx)
        wy = weights(ty)
        sx = slopes(tx)
        sy = slopes(ty)
        cx = curvatures(tx)
        cy = curvatures(ty)
        # --- gradients per sample instead of per metre: of rows of h, h_x, h_xx; of h_y, h_xy; of h_yy
        flat = vec3(grad_maps[b, 0, p], grad_maps[b, 1, p] * along_x, grad_maps[b, 3, p] * along_x * along_x)
        steep_h = grad_maps[b, 2, p] * along_y
        steep_x = grad_maps[b, 4, p] * along_x * along_y
        bent = grad_maps[b, 5, p] * along_y * along_y
        terms = vec16()
        for l in range(4):
            by_weight = wx[l] * flat[0] + sx[l] * flat[1] + cx[l] * flat[2]
            by_slope = wx[l] * steep_h + sx[l] * steep_x
            by_curvature = wx[l] * bent
            for k in range(4):
                term = wy[k] * by_weight + sy[k] * by_slope + cy[k] * by_curvature
                if wp.static(is_fixed):
                    wp.atomic_add(sums, b, row + 1 + k, column + 1 + l, counted(wp.float64(term) * steps[b]))
                else:
                    terms[4 * k + l] = term
        if wp.static(not is_fixed):
            add_to_cell(sums, b, row + 1, column + 1, terms)

    return share_gradient
