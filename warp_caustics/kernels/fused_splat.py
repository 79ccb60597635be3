"""The whole photon in one kernel, for collimated light: surface, refraction, footprint, pixels.

No records are stored, and nothing but the image is written. The formulas are in ``collimated.py``, the rule
for pixels in ``splat.py``.
"""

from functools import cache
from types import SimpleNamespace
from typing import Any, no_type_check

import warp as wp

from warp_caustics.kernels.collimated import collimated_functions
from warp_caustics.kernels.splat import BOX_VARIANCE, PROFILE_FACTORIES, window_functions
from warp_caustics.kernels.surface import surface_functions
from warp_caustics.kernels.trace import GRAZING, optics_struct


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
    inside_slope, exit_slope = functions.inside_slope, functions.exit_slope
    first_pixel, last_pixel = window_functions(dtype, profile)
    footprint_sigma, place, defer = functions.footprint_sigma, functions.place, functions.defer
    Optics = optics_struct(dtype)
    half = wp.constant(dtype(0.5))
    one = wp.constant(dtype(1.0))
    two = wp.constant(dtype(2.0))
    box = wp.constant(dtype(BOX_VARIANCE))
    grazing = wp.constant(dtype(GRAZING))
    one_lane = lanes == 1

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
        h_x = maps[1]
        h_y = maps[2]
        m = one + h_x * h_x + h_y * h_y
        thickness = optics.base + maps[0]
        v_x = h_x * maps[3] + h_y * maps[4]
        v_y = h_x * maps[4] + h_y * maps[5]
        scale_x = footprint_sigma(x, optics.half_x, optics)
        scale_y = footprint_sigma(y, optics.half_y, optics)
        for c in range(first_channel, end_channel):
            k, k1 = inside_slope(m, eta[c])
            e, e1, e2, q = exit_slope(m, eta[c], ratio[c])
            if q > grazing:
                shift = thickness * k + optics.gap * e
                shift1 = two * (thickness * k1 + optics.gap * e1)
                w_x = k * h_x + shift1 * v_x
                w_y = k * h_y + shift1 * v_y
                j_xx = (one + shift * maps[3] + h_x * w_x) * scale_x * optics.pixels_per_m_x
                j_xy = (shift * maps[4] + h_x * w_y) * scale_y * optics.pixels_per_m_x
                j_yx = (shift * maps[4] + h_y * w_x) * scale_x * optics.pixels_per_m_y
                j_yy = (one + shift * maps[5] + h_y * w_y) * scale_y * optics.pixels_per_m_y
                var_x = j_xx * j_xx + j_xy * j_xy
                cov = j_xx * j_yx + j_xy * j_yy
                var_y = j_yx * j_yx + j_yy * j_yy
                shrink = wp.min(one, optics.max_var / wp.max(var_x + var_y, optics.min_var))
                var_x = shrink * var_x + optics.min_var
                cov = shrink * cov
                var_y = shrink * var_y + optics.min_var
                column = (x + shift * h_x - optics.window_x) * optics.pixels_per_m_x
                row = (y + shift * h_y - optics.window_y) * optics.pixels_per_m_y
                amplitude = optics.area * radiosity[c]
                beta = cov / (var_y + box)
                sigma_y = wp.sqrt(var_y)
                sigma_x = wp.sqrt(var_x - beta * cov)
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
                        if wp.static(one_lane):
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
