"""Photons that lie anywhere, from surface to pixels and back, on a CPU: what ``fused.py`` does, block by block.

Photons of a block are refracted sixteen at a time by ``row_refraction.py``, through scratch memory as rows of a lattice
are (``rows.py``); surface and pixels are photon by photon. A launch of Warp runs on one core, block after block, so
blocks share their scratch memory.
"""

from types import SimpleNamespace
from typing import Any, no_type_check

import warp as wp

from warp_caustics.kernels.effects import Effects
from warp_caustics.kernels.footprint import footprint_struct
from warp_caustics.kernels.made_once import made_once
from warp_caustics.kernels.photons import bench_functions, photons_struct
from warp_caustics.kernels.pixels import adding_functions, gathering_function
from warp_caustics.kernels.row_refraction import (
    FOOTPRINT_PLANE,
    GRADIENT_PLANE,
    MAP_GRADIENT_PLANE,
    row_refraction_functions,
)
from warp_caustics.kernels.surface import photon_function

BLOCK = 64
"""Photons of a block, a multiple of sixteen: what is known of them stays in the first cache."""

PLACE_PLANES = 3
"""Rows of the scratch memory of places: nothing (``rows.py``: where in its cell a photon lies), x and y [m]."""


@made_once
def _block_functions(dtype: Any, effects: Effects) -> SimpleNamespace:
    """What both kernels share: ``surface_of_block`` and ``light_of_block``."""
    refract_block, _ = row_refraction_functions(dtype, effects, is_row=False)
    bench = bench_functions(dtype, effects)
    optics_of, colour_of = bench.optics_of, bench.colour_of
    photon_at = photon_function(dtype, False)
    Photons = photons_struct(dtype)
    zero = wp.constant(dtype(0.0))
    is_blocked = effects.second_hits

    @no_type_check
    @wp.func
    def surface_of_block(
        coefficients: wp.array3d[dtype],
        photons: Photons,
        b: wp.int32,
        first: wp.int32,
        count: wp.int32,
        places: wp.array2d[dtype],
        work: wp.array2d[dtype],
    ):
        """Places and surface maps of ``count`` photons from number ``first`` on."""
        for j in range(count):
            photon = photon_at(coefficients, photons, b, first + j)
            places[1, j] = photon.x
            places[2, j] = photon.y
            for plane in range(6):
                work[plane, j] = photon.maps[plane]

    @no_type_check
    @wp.func
    def light_of_block(
        places: wp.array2d[dtype],
        photons: Photons,
        b: wp.int32,
        c: wp.int32,
        first: wp.int32,
        count: wp.int32,
        work: wp.array2d[dtype],
    ):
        """Surface maps to footprints at one wavelength."""
        refract_block(places, zero, colour_of(photons, b, c), optics_of(photons, b), 0, count, work)
        if wp.static(is_blocked):
            for j in range(count):
                if photons.clear[b, c, first + j] == wp.uint8(0):
                    work[wp.static(FOOTPRINT_PLANE + 5), j] = zero

    return SimpleNamespace(surface_of_block=surface_of_block, light_of_block=light_of_block)


@made_once
def block_kernel(dtype: Any, profile: str, effects: Effects) -> Any:
    """Kernel ``splat_blocks``."""
    functions = _block_functions(dtype, effects)
    surface_of_block, light_of_block = functions.surface_of_block, functions.light_of_block
    adding = adding_functions(dtype, profile, 1, 1, False, True)
    row_window, add_rows = adding.row_window, adding.add_rows
    Photons, Footprints = photons_struct(dtype), footprint_struct(dtype, 1)
    vector = wp.types.vector(length=1, dtype=dtype)
    zero = wp.constant(dtype(0.0))

    @no_type_check
    @wp.kernel(enable_backward=False, module="unique")
    def splat_blocks(
        coefficients: wp.array3d[dtype],
        photons: Photons,
        places: wp.array2d[dtype],
        work: wp.array2d[dtype],
        # outputs
        image: wp.array4d[dtype],
    ):
        """Add blocks of photons to the image [W/m^2]; ``places`` and ``work`` are scratch memory.

        Spline coefficients [B, n + 4, n + 4].
        """
        b, block = wp.tid()
        first_photon = block * wp.static(BLOCK)
        count = wp.min(wp.static(BLOCK), photons.count - first_photon)
        surface_of_block(coefficients, photons, b, first_photon, count, places, work)
        for c in range(image.shape[1]):
            light_of_block(places, photons, b, c, first_photon, count, work)
            for j in range(count):
                amplitude = work[wp.static(FOOTPRINT_PLANE + 5), j]
                if amplitude > zero:
                    f = Footprints(
                        vector(work[wp.static(FOOTPRINT_PLANE), j]),
                        vector(work[wp.static(FOOTPRINT_PLANE + 1), j]),
                        vector(work[wp.static(FOOTPRINT_PLANE + 2), j]),
                        vector(work[wp.static(FOOTPRINT_PLANE + 3), j]),
                        vector(work[wp.static(FOOTPRINT_PLANE + 4), j]),
                        vector(amplitude),
                    )
                    first, last = row_window(f, image)
                    add_rows(f, first, last, b, c, 0, image)

    return splat_blocks


@made_once
def block_adjoint_kernel(dtype: Any, profile: str, effects: Effects) -> Any:
    """Kernel ``splat_blocks_adjoint``."""
    functions = _block_functions(dtype, effects)
    surface_of_block, light_of_block = functions.surface_of_block, functions.light_of_block
    _, refract_block_adjoint = row_refraction_functions(dtype, effects, is_row=False)
    gather = gathering_function(dtype, profile, 1, True)
    bench = bench_functions(dtype, effects)
    optics_of, colour_of = bench.optics_of, bench.colour_of
    Photons, Footprint = photons_struct(dtype), footprint_struct(dtype, 0)
    zero = wp.constant(dtype(0.0))

    @no_type_check
    @wp.kernel(enable_backward=False, module="unique")
    def splat_blocks_adjoint(
        coefficients: wp.array3d[dtype],
        photons: Photons,
        grad_image: wp.array4d[dtype],
        places: wp.array2d[dtype],
        work: wp.array2d[dtype],
        # outputs
        grad_maps: wp.array3d[dtype],
    ):
        """Gradient with respect to the surface maps [B, 6, N]."""
        b, block = wp.tid()
        first = block * wp.static(BLOCK)
        count = wp.min(wp.static(BLOCK), photons.count - first)
        surface_of_block(coefficients, photons, b, first, count, places, work)
        for c in range(grad_image.shape[1]):
            light_of_block(places, photons, b, c, first, count, work)
            for j in range(count):
                amplitude = work[wp.static(FOOTPRINT_PLANE + 5), j]
                if amplitude > zero:
                    f = Footprint(
                        work[wp.static(FOOTPRINT_PLANE), j],
                        work[wp.static(FOOTPRINT_PLANE + 1), j],
                        work[wp.static(FOOTPRINT_PLANE + 2), j],
                        work[wp.static(FOOTPRINT_PLANE + 3), j],
                        work[wp.static(FOOTPRINT_PLANE + 4), j],
                        amplitude,
                    )
                    g = gather(f, b, c, 0, grad_image)
                    work[wp.static(GRADIENT_PLANE), j] = g.column
                    work[wp.static(GRADIENT_PLANE + 1), j] = g.row
                    work[wp.static(GRADIENT_PLANE + 2), j] = g.sigma_x
                    work[wp.static(GRADIENT_PLANE + 3), j] = g.sigma_y
                    work[wp.static(GRADIENT_PLANE + 4), j] = g.beta
                    work[wp.static(GRADIENT_PLANE + 5), j] = g.amplitude
            refract_block_adjoint(places, zero, colour_of(photons, b, c), optics_of(photons, b), count, c == 0, work)
        for plane in range(6):
            for j in range(count):
                grad_maps[b, plane, first + j] = work[wp.static(MAP_GRADIENT_PLANE) + plane, j]

    return splat_blocks_adjoint
