"""The whole photon in one kernel, for collimated light: surface, refraction, footprint, pixels.

No records are stored, and nothing but the image is written. The formulas are in ``collimated.py``, the rule
for pixels in ``splat.py``.
"""

from functools import cache
from types import SimpleNamespace
from typing import Any, no_type_check

import warp as wp

from warp_caustics.kernels.collimated import collimated_functions
from warp_caustics.kernels.splat import PROFILE_FACTORIES, cpu_row_functions, window_functions
from warp_caustics.kernels.surface import surface_functions
from warp_caustics.kernels.trace import optics_struct


@cache
def fused_splat_kernels(dtype: Any, profile: str, lanes: int, is_lattice: bool, defers: bool) -> SimpleNamespace:
    """Kernels ``splat_photons`` and ``splat_deferred``.

    Args:
        dtype: wp.float32 or wp.float64.
        profile: shape of the footprint, one of ``PROFILES``.
        lanes: threads that share a footprint's columns; 1 for compact ones, several for wide ones on a GPU.
        is_lattice: photons lie on a grid (positions are its axes) instead of anywhere.
        defers: wide footprints are put on a list, for the ``deferred`` kernel of a variant with many lanes.
    """
    cumulative, _ = PROFILE_FACTORIES[profile](dtype)
    surface_at = surface_functions(dtype).surface_at
    functions = collimated_functions(dtype, profile, is_lattice)
    refraction, footprint = functions.refraction, functions.footprint
    place, defer = functions.place, functions.defer
    first_pixel, last_pixel = window_functions(dtype, profile)
    Optics = optics_struct(dtype)
    half = wp.constant(dtype(0.5))
    one = wp.constant(dtype(1.0))
    zero = wp.constant(dtype(0.0))
    one_lane = lanes == 1
    # GPU variants have several lanes or leave wide footprints to those that have.
    on_cpu = profile == "spline" and one_lane and not defers
    add_row, _ = cpu_row_functions(dtype)

    @no_type_check
    @wp.func
    def splat_photon(
        b: wp.int32,
        p: wp.int32,
        first_channel: wp.int32,
        end_channel: wp.int32,
        lane: wp.int32,
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
        image: wp.array4d[dtype],
        deferred: wp.array[wp.int32],
        deferred_count: wp.array[wp.int32],
    ):
        """Add the footprints of photon p in some channels; wide ones are put off if asked for."""
        x, y = place(positions, p, columns)
        maps = surface_at(coefficients, b, x, y, samples_per_m_x, samples_per_m_y, n)
        for c in range(first_channel, end_channel):
            slopes = refraction(maps, eta[c], ratio[c])
            f = footprint(x, y, maps, slopes, radiosity[c], optics)
            if f[5] != zero:
                column = f[0]
                row = f[1]
                sigma_x = f[2]
                sigma_y = f[3]
                beta = f[4]
                amplitude = f[5]
                inv_x = one / sigma_x
                inv_y = one / sigma_y
                here = True
                if wp.static(defers):
                    here = not defer(
                        b, p, c, lane, photons, image.shape[1], sigma_x, sigma_y, optics, deferred, deferred_count
                    )
                if here:
                    first_row = first_pixel(row, sigma_y)
                    below = cumulative((dtype(first_row) - row) * inv_y)
                    for i in range(first_row, last_pixel(row, sigma_y, image.shape[2]) + 1):
                        above = cumulative((dtype(i + 1) - row) * inv_y)
                        share = amplitude * (above - below)
                        below = above
                        centre = column + beta * (dtype(i) + half - row)
                        first_column = first_pixel(centre, sigma_x)
                        last_column = last_pixel(centre, sigma_x, image.shape[3])
                        if wp.static(on_cpu):
                            add_row(image, b, c, i, first_column, last_column, centre, inv_x, share)
                        elif wp.static(one_lane):
                            left = cumulative((dtype(first_column) - centre) * inv_x)
                            for j in range(first_column, last_column + 1):
                                right = cumulative((dtype(j + 1) - centre) * inv_x)
                                wp.atomic_add(image, b, c, i, j, share * (right - left))
                                left = right
                        else:
                            for j in range(first_column + lane, last_column + 1, wp.static(lanes)):
                                left = cumulative((dtype(j) - centre) * inv_x)
                                right = cumulative((dtype(j + 1) - centre) * inv_x)
                                wp.atomic_add(image, b, c, i, j, share * (right - left))

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
        image: wp.array4d[dtype],
        deferred: wp.array[wp.int32],
        deferred_count: wp.array[wp.int32],
    ):
        """Add the photons to image [B, C, H, W] [W/m^2].

        Positions [N, 2] [m], or for a lattice its axes [2, columns]: x in row 0, y in row 1. ``deferred`` lists the
        wide footprints left to the other kernel, ``deferred_count`` is their number.
        """
        b, p, lane = wp.tid()
        splat_photon(
            b,
            p,
            0,
            image.shape[1],
            lane,
            coefficients,
            positions,
            photons,
            columns,
            samples_per_m_x,
            samples_per_m_y,
            n,
            eta,
            ratio,
            radiosity,
            optics,
            image,
            deferred,
            deferred_count,
        )

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
        deferred: wp.array[wp.int32],
        deferred_count: wp.array[wp.int32],
        # outputs
        image: wp.array4d[dtype],
    ):
        """Add the footprints on the list; a group of threads shares the columns of each."""
        group, lane = wp.tid()
        channels = image.shape[1]
        for item in range(group, deferred_count[0], groups):
            c = deferred[item] % channels
            photon = deferred[item] // channels
            b = photon // photons
            splat_photon(
                b,
                photon - b * photons,
                c,
                c + 1,
                lane,
                coefficients,
                positions,
                photons,
                columns,
                samples_per_m_x,
                samples_per_m_y,
                n,
                eta,
                ratio,
                radiosity,
                optics,
                image,
                deferred,
                deferred_count,
            )

    return SimpleNamespace(splat_photons=splat_photons, splat_deferred=splat_deferred)
