"""``fused_splat.py`` for packed images: all channels of a photon at once (see ``packed.py``)."""

from functools import cache
from types import SimpleNamespace
from typing import Any, no_type_check

import warp as wp

from warp_caustics.kernels.packed import BLOCK_ROWS, packed_functions
from warp_caustics.kernels.splat import PROFILE_FACTORIES
from warp_caustics.kernels.trace import optics_struct


@cache
def _row_functions(dtype: Any, profile: str, width: int, lanes: int, is_lattice: bool) -> Any:
    """Warp function that adds some rows of the footprints of ``width`` channels to a packed image."""
    cumulative, _ = PROFILE_FACTORIES[profile](dtype)
    functions = packed_functions(dtype, profile, width, is_lattice)
    Footprints, vector, window, add = functions.Footprints, functions.vector, functions.window, functions.add
    half = wp.constant(dtype(0.5))
    one = wp.constant(dtype(1.0))

    @no_type_check
    @wp.func
    def cumulatives(edge: dtype, centre: vector, inv: vector):
        values = vector()
        for k in range(wp.static(width)):
            values[k] = cumulative((edge - centre[k]) * inv[k])
        return values

    @no_type_check
    @wp.func
    def add_rows(
        f: Footprints,
        b: wp.int32,
        channel: wp.int32,
        block: wp.int32,
        rows: wp.int32,
        lane: wp.int32,
        packed: wp.array4d[dtype],
    ):
        """Add so many rows, from the block's first; a single channel goes to its place in the pixel."""
        inv_x = wp.cw_div(vector(one), f.sigma_x)
        inv_y = wp.cw_div(vector(one), f.sigma_y)
        first_row, last_row = window(f.row, f.sigma_y, packed.shape[1])
        first_row += block * rows
        last_row = wp.min(last_row, first_row + rows - 1)
        below = cumulatives(dtype(first_row), f.row, inv_y)
        for i in range(first_row, last_row + 1):
            above = cumulatives(dtype(i + 1), f.row, inv_y)
            share = wp.cw_mul(f.amplitude, above - below)
            below = above
            centre = f.column + wp.cw_mul(f.beta, vector(dtype(i) + half) - f.row)
            first, last = window(centre, f.sigma_x, packed.shape[2])
            left = vector()
            if wp.static(lanes == 1):
                left = cumulatives(dtype(first), centre, inv_x)
            for j in range(first + lane, last + 1, wp.static(lanes)):
                if wp.static(lanes > 1):
                    left = cumulatives(dtype(j), centre, inv_x)
                right = cumulatives(dtype(j + 1), centre, inv_x)
                light = wp.cw_mul(share, right - left)
                left = right
                if wp.static(width > 1):
                    add(packed, b, i, j, light)
                else:
                    wp.atomic_add(packed, b, i, j, channel, light[0])

    return add_rows


@cache
def packed_splat_kernels(dtype: Any, profile: str, channels: int, lanes: int, is_lattice: bool) -> SimpleNamespace:
    """Kernels ``splat_photons`` (one lane) and ``splat_deferred``.

    Args:
        dtype: wp.float32 or wp.float64.
        profile: shape of the footprint, one of ``PROFILES``.
        channels: wavelengths of the image, 2 to ``PACK``.
        lanes: threads that share the columns of a deferred footprint.
        is_lattice: photons lie on a grid (positions are its axes) instead of anywhere.
    """
    together = packed_functions(dtype, profile, channels, is_lattice)
    alone = packed_functions(dtype, profile, 1, is_lattice)
    start_of, footprints, window, pixels = together.start_of, together.footprints, together.window, together.pixels
    put_off, footprint_of = together.put_off, alone.footprints
    add_rows = _row_functions(dtype, profile, channels, 1, is_lattice)
    add_rows_of = _row_functions(dtype, profile, 1, 1, is_lattice)
    add_block = _row_functions(dtype, profile, channels, lanes, is_lattice)
    add_block_of = _row_functions(dtype, profile, 1, lanes, is_lattice)
    Optics = optics_struct(dtype)

    @no_type_check
    @wp.kernel(enable_backward=False, module="unique")
    def splat_photons(
        coefficients: wp.array3d[dtype],
        positions: wp.array2d[dtype],
        photons: wp.int32,
        columns: wp.int32,
        samples_per_m_x: dtype,
        samples_per_m_y: dtype,
        n: wp.int32,
        eta: wp.array[dtype],
        ratio: wp.array[dtype],
        radiosity: wp.array[dtype],
        optics: Optics,
        # outputs
        packed: wp.array4d[dtype],
        deferred: wp.array2d[wp.int32],
        deferred_count: wp.array[wp.int32],
    ):
        """Add the photons to the packed image, but for the wide ones, which are put on the list."""
        b, p = wp.tid()
        start = start_of(coefficients, positions, b, p, columns, samples_per_m_x, samples_per_m_y, n)
        f = footprints(start, 0, eta, ratio, radiosity, optics)
        most, is_apart = pixels(f)
        here = True
        if most > optics.wide_pixels:
            first, last = window(f.row, f.sigma_y, packed.shape[1])
            here = first <= last
            if here:
                here = not put_off(b * photons + p, first, last, deferred, deferred_count)
        if here:
            if is_apart:
                for c in range(eta.shape[0]):
                    f_c = footprint_of(start, c, eta, ratio, radiosity, optics)
                    add_rows_of(f_c, b, c, 0, packed.shape[1], 0, packed)
            else:
                add_rows(f, b, 0, 0, packed.shape[1], 0, packed)

    @no_type_check
    @wp.kernel(enable_backward=False, module="unique")
    def splat_deferred(
        coefficients: wp.array3d[dtype],
        positions: wp.array2d[dtype],
        photons: wp.int32,
        columns: wp.int32,
        samples_per_m_x: dtype,
        samples_per_m_y: dtype,
        n: wp.int32,
        eta: wp.array[dtype],
        ratio: wp.array[dtype],
        radiosity: wp.array[dtype],
        optics: Optics,
        groups: wp.int32,
        deferred: wp.array2d[wp.int32],
        deferred_count: wp.array[wp.int32],
        # outputs
        packed: wp.array4d[dtype],
    ):
        """Add the blocks of rows on the list; a group of threads shares the columns of each."""
        group, lane = wp.tid()
        for item in range(group, wp.min(deferred_count[0], deferred.shape[0]), groups):
            photon = deferred[item, 0]
            block = deferred[item, 1]
            if photon >= 0:
                b = photon // photons
                p = photon - b * photons
                start = start_of(coefficients, positions, b, p, columns, samples_per_m_x, samples_per_m_y, n)
                f = footprints(start, 0, eta, ratio, radiosity, optics)
                most, is_apart = pixels(f)
                if is_apart:
                    for c in range(eta.shape[0]):
                        f_c = footprint_of(start, c, eta, ratio, radiosity, optics)
                        add_block_of(f_c, b, c, block, wp.static(BLOCK_ROWS), lane, packed)
                else:
                    add_block(f, b, 0, block, wp.static(BLOCK_ROWS), lane, packed)

    return SimpleNamespace(splat_photons=splat_photons, splat_deferred=splat_deferred)
