"""Rows of lattice photons from surface to pixels and back, on a CPU: what ``fused.py`` does, sixteen photons at a time.

A row goes through scratch memory in three steps, ``row_surface.py``, ``row_refraction.py`` and ``row_pixels.py``. A
launch of Warp runs on one core, row after row, so rows share their scratch memory; every core has a launch and an image
of its own (``chunked.py``).
"""

from types import SimpleNamespace
from typing import Any, no_type_check

import warp as wp

from warp_caustics.kernels.effects import Effects
from warp_caustics.kernels.footprint import footprint_struct
from warp_caustics.kernels.made_once import made_once
from warp_caustics.kernels.photons import bench_functions, photons_struct
from warp_caustics.kernels.pixels import adding_functions, gathering_function
from warp_caustics.kernels.row_pixels import row_pixel_functions
from warp_caustics.kernels.row_refraction import (
    FOOTPRINT_PLANE,
    GRADIENT_PLANE,
    MAP_GRADIENT_PLANE,
    SIDE_PLANE,
    row_refraction_functions,
)
from warp_caustics.kernels.row_surface import both_ways_function, row_surface_functions
from warp_caustics.kernels.second_hits import march_function
from warp_caustics.kernels.surface import surface_functions


@made_once
def _row_functions(dtype: Any, effects: Effects) -> SimpleNamespace:
    """What both kernels share: ``along_y``, ``footprint_of`` and ``light_of_row``."""
    surface = surface_functions(dtype)
    weights, slopes, curvatures = surface.spline_weights, surface.spline_slopes, surface.spline_curvatures
    refract_row, _ = row_refraction_functions(dtype, effects)
    bench = bench_functions(dtype, effects)
    optics_of, colour_of = bench.optics_of, bench.colour_of
    Photons = photons_struct(dtype)
    Footprint = footprint_struct(dtype, 0)
    clear_path = march_function(dtype, effects)
    half = wp.constant(dtype(0.5))
    zero = wp.constant(dtype(0.0))
    one = wp.constant(dtype(1.0))
    is_blocked = effects.second_hits

    @no_type_check
    @wp.func
    def along_y(y: dtype, photons: Photons):
        """First of four rows of coefficients, and their weights, slopes and curvatures [per m]."""
        n = photons.samples
        per_m = photons.samples_per_m_y
        v = y * per_m + half * dtype(n) - half
        row = wp.clamp(wp.int32(wp.floor(v)), -1, n - 1)
        t = v - dtype(row)
        return row + 1, weights(t), slopes(t) * per_m, curvatures(t) * (per_m * per_m)

    @no_type_check
    @wp.func
    def footprint_of(work: wp.array2d[dtype], plane: wp.int32, j: wp.int32):
        """Footprint in column j, or its gradient."""
        return Footprint(
            work[plane, j],
            work[plane + 1, j],
            work[plane + 2, j],
            work[plane + 3, j],
            work[plane + 4, j],
            work[plane + 5, j],
        )

    @no_type_check
    @wp.func
    def light_of_row(
        coefficients: wp.array3d[dtype],
        bounds: wp.array2d[dtype],
        across: wp.array2d[dtype],
        y: dtype,
        photons: Photons,
        b: wp.int32,
        c: wp.int32,
        begin: wp.int32,
        end: wp.int32,
        work: wp.array2d[dtype],
    ):
        """Surface maps to footprints of some columns of a row at one wavelength."""
        colour = colour_of(photons, b, c)
        optics = optics_of(photons, b)
        refract_row(across, y, colour, optics, begin, end, work)
        if wp.static(is_blocked):
            # Only paths so flat that the relief may come nearer are followed.
            lowest = bounds[b, 0]
            steepest = bounds[b, 1]
            for j in range(begin, end):
                lit = work[wp.static(FOOTPRINT_PLANE + 5), j] > zero
                if lit and work[wp.static(SIDE_PLANE), j] * steepest * steepest > one:
                    clear = clear_path(
                        coefficients,
                        photons,
                        b,
                        across[1, j],
                        y,
                        work[0, j],
                        work[1, j],
                        work[2, j],
                        colour,
                        optics,
                        lowest,
                        steepest,
                    )
                    if clear == wp.uint8(0):
                        work[wp.static(FOOTPRINT_PLANE + 5), j] = zero

    return SimpleNamespace(along_y=along_y, footprint_of=footprint_of, light_of_row=light_of_row)


@made_once
def row_kernels(dtype: Any, effects: Effects) -> SimpleNamespace:
    """Kernels ``splat_rows``, ``splat_changes`` and ``filter_planes``, compiled together."""
    module = "_".join((__name__, dtype.__name__, *(str(int(is_on)) for is_on in effects)))
    both_ways = both_ways_function(dtype)
    functions = _row_functions(dtype, effects)
    along_y, footprint_of, light_of_row = functions.along_y, functions.footprint_of, functions.light_of_row
    row_maps, _ = row_surface_functions(dtype)
    add_row_of_photons, _ = row_pixel_functions(dtype)
    adding = adding_functions(dtype, "spline", 1, 1, False, True)
    row_window, add_rows = adding.row_window, adding.add_rows
    Photons, Footprints = photons_struct(dtype), footprint_struct(dtype, 1)
    vector = wp.types.vector(length=1, dtype=dtype)

    @no_type_check
    @wp.func
    def add_photons(
        work: wp.array2d[dtype],
        begin: wp.int32,
        end: wp.int32,
        b: wp.int32,
        c: wp.int32,
        image: wp.array4d[dtype],
        listed: wp.array[wp.int32],
        lit_rows: wp.array2d[wp.int32],
    ):
        """Footprints in some columns of a row to pixels of one wavelength."""
        others = add_row_of_photons(work, begin, end, b, c, image, listed, lit_rows)
        for k in range(others):
            f = footprint_of(work, wp.static(FOOTPRINT_PLANE), listed[k])
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
    @wp.kernel(enable_backward=False, module=module)
    def filter_planes(
        matrix: wp.array2d[dtype],
        transposed: wp.array2d[dtype],
        planes: wp.array3d[dtype],
        reach: wp.int32,
        work: wp.array[dtype],
        # outputs
        filtered: wp.array3d[dtype],
    ):
        """filtered[b] = matrix @ planes[b] @ transposed: heights to coefficients, and the adjoint of that."""
        both_ways(matrix, transposed, planes, wp.tid(), reach, work, filtered)

    @no_type_check
    @wp.kernel(enable_backward=False, module=module)
    def splat_rows(
        coefficients: wp.array3d[dtype],
        photons: Photons,
        bounds: wp.array2d[dtype],
        across: wp.array2d[dtype],
        first_photon: wp.array[wp.int32],
        by_cell: wp.array2d[dtype],
        work: wp.array2d[dtype],
        listed: wp.array[wp.int32],
        # outputs
        image: wp.array4d[dtype],
        lit_rows: wp.array2d[wp.int32],
    ):
        """Add rows of lattice photons to the image [W/m^2].

        Rows of pixels from ``lit_rows[b, 0]`` to before ``lit_rows[b, 1]`` hold sums; others hold nothing, and are set
        to zero when light comes to them. Spline coefficients are [B, n + 4, n + 4], ``bounds_of`` them [B, 2]; for the
        rest, scratch memory and the lattice, see ``lattice_rows.py``.
        """
        b, i = wp.tid()
        y = photons.positions[1, i]
        cell_row, weights, slopes, curvatures = along_y(y, photons)
        row_maps(
            coefficients,
            b,
            cell_row,
            weights,
            slopes,
            curvatures,
            photons.samples_per_m_x,
            across,
            first_photon,
            0,
            photons.samples + 1,
            by_cell,
            work,
        )
        for c in range(image.shape[1]):
            light_of_row(coefficients, bounds, across, y, photons, b, c, 0, photons.columns, work)
            add_photons(work, 0, photons.columns, b, c, image, listed, lit_rows)

    @no_type_check
    @wp.kernel(enable_backward=False, module=module)
    def splat_changes(
        coefficients: wp.array3d[dtype],
        touched: wp.array3d[wp.int32],
        photons: Photons,
        bounds: wp.array2d[dtype],
        across: wp.array2d[dtype],
        first_photon: wp.array[wp.int32],
        by_cell: wp.array2d[dtype],
        work: wp.array2d[dtype],
        listed: wp.array[wp.int32],
        # outputs
        image: wp.array4d[dtype],
        lit_rows: wp.array2d[wp.int32],
    ):
        """Add to image b [W/m^2] what a second relief shows of rows of lattice photons, less what a first one does.

        Coefficients, [F + B, n + 4, n + 4], are those of one first relief or as many as second ones, and then these. Of
        each row only photons from the first to the last cell that may differ: in row r of coefficients from column
        ``touched[b, r, 0]`` to before ``touched[b, r, 1]``. The rest is as in ``splat_rows``.
        """
        b, i = wp.tid()
        y = photons.positions[1, i]
        cell_row, weights, slopes, curvatures = along_y(y, photons)
        low = touched[b, cell_row, 0]
        high = touched[b, cell_row, 1]
        for r in range(1, 4):
            low = wp.min(low, touched[b, cell_row + r, 0])
            high = wp.max(high, touched[b, cell_row + r, 1])
        # A photon lies between four coefficients.
        first_cell = wp.max(low - 3, 0)
        end_cell = wp.min(high, photons.samples + 1)
        if first_cell < end_cell:
            begin = first_photon[first_cell]
            end = first_photon[end_cell]
            if begin < end:
                firsts = coefficients.shape[0] - image.shape[0]
                for is_new in range(2):
                    k = wp.min(b, firsts - 1)
                    if is_new == 1:
                        k = firsts + b
                    row_maps(
                        coefficients,
                        k,
                        cell_row,
                        weights,
                        slopes,
                        curvatures,
                        photons.samples_per_m_x,
                        across,
                        first_photon,
                        first_cell,
                        end_cell,
                        by_cell,
                        work,
                    )
                    for c in range(image.shape[1]):
                        light_of_row(coefficients, bounds, across, y, photons, k, c, begin, end, work)
                        if is_new == 0:
                            for j in range(begin, end):
                                amplitude = work[wp.static(FOOTPRINT_PLANE + 5), j]
                                work[wp.static(FOOTPRINT_PLANE + 5), j] = -amplitude
                        add_photons(work, begin, end, b, c, image, listed, lit_rows)

    return SimpleNamespace(splat_rows=splat_rows, splat_changes=splat_changes, filter_planes=filter_planes)


@made_once
def row_adjoint_kernel(dtype: Any, effects: Effects) -> Any:
    """Kernel ``splat_rows_adjoint``."""
    functions = _row_functions(dtype, effects)
    along_y, footprint_of, light_of_row = functions.along_y, functions.footprint_of, functions.light_of_row
    row_maps, row_maps_adjoint = row_surface_functions(dtype)
    _, refract_row_adjoint = row_refraction_functions(dtype, effects)
    _, gather_row_of_photons = row_pixel_functions(dtype)
    gather = gathering_function(dtype, "spline", 1, True)
    bench = bench_functions(dtype, effects)
    optics_of, colour_of = bench.optics_of, bench.colour_of
    Photons = photons_struct(dtype)

    @no_type_check
    @wp.kernel(enable_backward=False, module="unique")
    def splat_rows_adjoint(
        coefficients: wp.array3d[dtype],
        photons: Photons,
        grad_image: wp.array4d[dtype],
        bounds: wp.array2d[dtype],
        across: wp.array2d[dtype],
        first_photon: wp.array[wp.int32],
        by_cell: wp.array2d[dtype],
        work: wp.array2d[dtype],
        listed: wp.array[wp.int32],
        # outputs
        grad_coefficients: wp.array3d[dtype],
    ):
        """Add to the gradient of the coefficients [B, n + 4, n + 4] what rows of lattice photons contribute."""
        b, i = wp.tid()
        y = photons.positions[1, i]
        cell_row, weights, slopes, curvatures = along_y(y, photons)
        row_maps(
            coefficients,
            b,
            cell_row,
            weights,
            slopes,
            curvatures,
            photons.samples_per_m_x,
            across,
            first_photon,
            0,
            photons.samples + 1,
            by_cell,
            work,
        )
        for c in range(grad_image.shape[1]):
            light_of_row(coefficients, bounds, across, y, photons, b, c, 0, photons.columns, work)
            others = gather_row_of_photons(work, 0, photons.columns, b, c, grad_image, listed)
            for k in range(others):
                j = listed[k]
                g = gather(footprint_of(work, wp.static(FOOTPRINT_PLANE), j), b, c, 0, grad_image)
                work[wp.static(GRADIENT_PLANE), j] = g.column
                work[wp.static(GRADIENT_PLANE + 1), j] = g.row
                work[wp.static(GRADIENT_PLANE + 2), j] = g.sigma_x
                work[wp.static(GRADIENT_PLANE + 3), j] = g.sigma_y
                work[wp.static(GRADIENT_PLANE + 4), j] = g.beta
                work[wp.static(GRADIENT_PLANE + 5), j] = g.amplitude
            refract_row_adjoint(
                across, y, colour_of(photons, b, c), optics_of(photons, b), photons.columns, c == 0, work
            )
        row_maps_adjoint(
            coefficients,
            b,
            cell_row,
            weights,
            slopes,
            curvatures,
            photons.samples_per_m_x,
            across,
            first_photon,
            by_cell,
            work,
            wp.static(MAP_GRADIENT_PLANE),
            grad_coefficients,
        )

    return splat_rows_adjoint
