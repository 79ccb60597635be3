"""Footprint records to pixels and back, for point lights and tapes; the rule for pixels is in ``pixels.py``.

One thread does all pixels of a footprint: no lanes, no lists of wide footprints, no packed images.
"""

from types import SimpleNamespace
from typing import Any, no_type_check

import warp as wp

from warp_caustics.kernels.footprint import footprint_functions, footprint_struct
from warp_caustics.kernels.made_once import made_once
from warp_caustics.kernels.pixels import adding_functions, gathering_function


@made_once
def splat_kernels(dtype: Any, profile: str, on_cpu: bool) -> SimpleNamespace:
    """Kernels for float32 or float64 and a profile: ``splat`` and ``splat_adjoint``."""
    adding = adding_functions(dtype, profile, 1, 1, False, on_cpu)
    row_window, add_rows = adding.row_window, adding.add_rows
    gather = gathering_function(dtype, profile, 1, on_cpu)
    functions = footprint_functions(dtype)
    footprint_of, covariance_adjoint = functions.footprint_of, functions.covariance_adjoint
    Footprints = footprint_struct(dtype, 1)
    vector = wp.types.vector(length=1, dtype=dtype)
    vec3 = wp.types.vector(length=3, dtype=dtype)
    zero = wp.constant(dtype(0.0))

    @no_type_check
    @wp.func
    def read(records: wp.array4d[dtype], b: wp.int32, c: wp.int32, p: wp.int32):
        """Footprint of a record."""
        covariance = vec3(records[b, c, 2, p], records[b, c, 3, p], records[b, c, 4, p])
        return footprint_of(records[b, c, 0, p], records[b, c, 1, p], covariance, records[b, c, 5, p])

    @no_type_check
    @wp.kernel(enable_backward=False, module="unique")
    def splat(
        records: wp.array4d[dtype],
        # outputs
        image: wp.array4d[dtype],
    ):
        """Add every footprint of records [B, C, 6, N] (RECORD_NAMES) to image [B, C, H, W] [W/m^2]."""
        b, c, p = wp.tid()
        if records[b, c, 5, p] != zero:
            f = read(records, b, c, p)
            alone = Footprints(
                vector(f.column),
                vector(f.row),
                vector(f.sigma_x),
                vector(f.sigma_y),
                vector(f.beta),
                vector(f.amplitude),
            )
            first, last = row_window(alone, image)
            add_rows(alone, first, last, b, c, 0, image)

    @no_type_check
    @wp.kernel(enable_backward=False, module="unique")
    def splat_adjoint(
        records: wp.array4d[dtype],
        grad_image: wp.array4d[dtype],
        # outputs
        grad_records: wp.array4d[dtype],
    ):
        """Adjoint of ``splat``: gradient with respect to the records from that with respect to the image."""
        b, c, p = wp.tid()
        amplitude = records[b, c, 5, p]
        for plane in range(6):
            grad_records[b, c, plane, p] = zero
        if amplitude != zero:
            f = read(records, b, c, p)
            g = gather(f, b, c, 0, grad_image)
            g_covariance = covariance_adjoint(f, records[b, c, 4, p], g)
            grad_records[b, c, 0, p] = amplitude * g.column
            grad_records[b, c, 1, p] = amplitude * g.row
            grad_records[b, c, 2, p] = amplitude * g_covariance[0]
            grad_records[b, c, 3, p] = amplitude * g_covariance[1]
            grad_records[b, c, 4, p] = amplitude * g_covariance[2]
            grad_records[b, c, 5, p] = g.amplitude

    return SimpleNamespace(splat=splat, splat_adjoint=splat_adjoint)
