"""Light paths from the relief to the screen, stage by stage: for tapes, and for accounts of where light goes.

What happens on the way is in ``general.py``.
"""

from types import SimpleNamespace
from typing import Any, no_type_check

import warp as wp

from warp_caustics.kernels.effects import PLAIN, Effects
from warp_caustics.kernels.general import FAR_PX, GRAZING, general_functions
from warp_caustics.kernels.made_once import made_once
from warp_caustics.kernels.path import path_functions
from warp_caustics.kernels.photons import bench_functions, photons_struct

LANDED, OFF_SCREEN, REFLECTED, UNLIT, NOT_FINITE = range(5)
"""Fates of a light path: inside the image window, beside it, totally reflected at the bottom face,
outside the source's cone or on a face turned away from it, non-finite."""

FATE_NAMES = ("landed", "off_screen", "reflected", "unlit", "not_finite")

MET_AGAIN = len(FATE_NAMES)
"""Fate of a path that is lost because it meets the relief again; only where that is asked for."""


@made_once
def trace_kernels(dtype: Any, effects: Effects = PLAIN) -> SimpleNamespace:
    """Kernels for float32 or float64 and some effects: ``trace`` and ``land``."""
    is_blocked = effects.second_hits
    paths, general, bench = (
        path_functions(dtype, effects),
        general_functions(dtype, effects),
        bench_functions(dtype, effects),
    )
    incidence, refracted_slope = paths.incidence, paths.refracted_slope
    lit_area, passed, landing, record_of = general.lit_area, general.passed, general.landing, general.record
    optics_of, colour_of = bench.optics_of, bench.colour_of
    vec2 = wp.types.vector(length=2, dtype=dtype)
    vec3 = wp.types.vector(length=3, dtype=dtype)
    vec6 = wp.types.vector(length=6, dtype=dtype)
    Photons = photons_struct(dtype)
    zero = wp.constant(dtype(0.0))
    one = wp.constant(dtype(1.0))
    grazing = wp.constant(dtype(GRAZING))
    far = wp.constant(dtype(FAR_PX))

    @no_type_check
    @wp.kernel(module="unique")
    def trace(
        maps: wp.array3d[dtype],
        photons: Photons,
        # outputs
        records: wp.array4d[dtype],
    ):
        """Footprint records [B, C, 6, N] (RECORD_NAMES) from surface maps [B, 6, N] at positions [N, 2] [m]."""
        b, c, p = wp.tid()
        optics = optics_of(photons, b)
        here = vec6(maps[b, 0, p], maps[b, 1, p], maps[b, 2, p], maps[b, 3, p], maps[b, 4, p], maps[b, 5, p])
        record = record_of(here, photons.positions[p, 0], photons.positions[p, 1], colour_of(photons, b, c), optics)
        is_clear = True
        if wp.static(is_blocked):
            is_clear = photons.clear[b, c, p] != wp.uint8(0)
        if not is_clear:
            record = vec6(far, far, optics.min_var, zero, optics.min_var, zero)
        for plane in range(6):
            records[b, c, plane, p] = record[plane]

    @no_type_check
    @wp.kernel(enable_backward=False, module="unique")
    def land(
        maps: wp.array3d[dtype],
        photons: Photons,
        # outputs
        landings: wp.array4d[dtype],
        energies: wp.array3d[dtype],
        shares: wp.array3d[dtype],
        fates: wp.array3d[wp.int32],
    ):
        """Screen position [px] [B, C, 2, N]; flux for unit radiosity over pixel area, share of it that the faces
        let through, and fate, all [B, C, N]. Light that does not get behind the plate has a share of 1.
        """
        b, c, p = wp.tid()
        x = photons.positions[p, 0]
        y = photons.positions[p, 1]
        optics = optics_of(photons, b)
        colour = colour_of(photons, b, c)
        ratio = colour.ratio
        h = maps[b, 0, p]
        w, distance = incidence(x, y, h, optics)
        m = vec3(-maps[b, 1, p], -maps[b, 2, p], one)
        eta = colour.eta
        t, q = refracted_slope(w, m, eta, ratio)
        lit = lit_area(w, m, distance, optics)
        share = one
        fate = wp.static(LANDED)
        centre = vec2(far, far)
        is_clear = True
        if wp.static(is_blocked):
            is_clear = photons.clear[b, c, p] != wp.uint8(0)
        if not (lit > zero):
            fate = wp.static(UNLIT)
        elif not is_clear:
            fate = wp.static(MET_AGAIN)
        elif not wp.isfinite(q):
            fate = wp.static(NOT_FINITE)
        elif q <= grazing:
            fate = wp.static(REFLECTED)
        else:
            centre = landing(x, y, h, t, q, ratio, optics)
            share = passed(w, m, t, q, eta, ratio, colour.flat_share)
            if not (wp.isfinite(centre[0]) and wp.isfinite(centre[1])):
                fate = wp.static(NOT_FINITE)
            elif (
                centre[0] < zero
                or centre[0] > optics.image_pixels
                or centre[1] < zero
                or centre[1] > optics.image_pixels
            ):
                fate = wp.static(OFF_SCREEN)
        landings[b, c, 0, p] = centre[0]
        landings[b, c, 1, p] = centre[1]
        energies[b, c, p] = lit
        shares[b, c, p] = share
        fates[b, c, p] = fate

    return SimpleNamespace(trace=trace, land=land)
