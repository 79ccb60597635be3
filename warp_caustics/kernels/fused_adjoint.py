"""Adjoint of ``fused_splat.py``, written by hand: from the image gradient to that of the surface maps.

Every photon repeats its forward pass, takes the moments of the image gradient under its footprints, and goes
back through covariance, Jacobian and refraction. It reads the image and writes its own six numbers: no atomics, and the
same result every time, unless several threads share a footprint.
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
def fused_adjoint_kernels(dtype: Any, profile: str, lanes: int, is_lattice: bool, defers: bool) -> SimpleNamespace:
    """Kernels ``splat_photons_adjoint`` and ``splat_deferred_adjoint``.

    Args:
        dtype: wp.float32 or wp.float64.
        profile: shape of the footprint, one of ``PROFILES``.
        lanes: threads that share a footprint's columns; 1 for compact ones, several for wide ones on a GPU.
        is_lattice: photons lie on a grid (positions are its axes) instead of anywhere.
        defers: wide footprints are put on a list, for the ``deferred`` kernel of a variant with many lanes.
    """
    cumulative, density = PROFILE_FACTORIES[profile](dtype)
    surface_at = surface_functions(dtype).surface_at
    functions = collimated_functions(dtype, profile, is_lattice)
    inside_slope, exit_slope = functions.inside_slope, functions.exit_slope
    first_pixel, last_pixel = window_functions(dtype, profile)
    footprint_sigma, place, defer = functions.footprint_sigma, functions.place, functions.defer
    inside_curvature = functions.inside_curvature
    Optics = optics_struct(dtype)
    half = wp.constant(dtype(0.5))
    one = wp.constant(dtype(1.0))
    two = wp.constant(dtype(2.0))
    box = wp.constant(dtype(BOX_VARIANCE))
    grazing = wp.constant(dtype(GRAZING))
    zero = wp.constant(dtype(0.0))
    vec6 = wp.types.vector(length=6, dtype=dtype)
    one_lane = lanes == 1

    @no_type_check
    @wp.func
    def gather_photon(
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
        grad_image: wp.array4d[dtype],
        deferred: wp.array[wp.int32],
        deferred_count: wp.array[wp.int32],
    ):
        """Gradient of photon p's surface maps in some channels, vec6; wide footprints are put off if asked for."""
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
        g_h = zero
        g_hx = zero
        g_hy = zero
        g_hxx = zero
        g_hxy = zero
        g_hyy = zero
        g_m = zero
        g_vx = zero
        g_vy = zero
        for c in range(first_channel, end_channel):
            k, k1 = inside_slope(m, eta[c])
            e, e1, e2, q = exit_slope(m, eta[c], ratio[c])
            if q > grazing:
                # The forward pass, as above.
                shift = thickness * k + optics.gap * e
                shift1 = two * (thickness * k1 + optics.gap * e1)
                w_x = k * h_x + shift1 * v_x
                w_y = k * h_y + shift1 * v_y
                j_xx = (one + shift * maps[3] + h_x * w_x) * scale_x * optics.pixels_per_m_x
                j_xy = (shift * maps[4] + h_x * w_y) * scale_y * optics.pixels_per_m_x
                j_yx = (shift * maps[4] + h_y * w_x) * scale_x * optics.pixels_per_m_y
                j_yy = (one + shift * maps[5] + h_y * w_y) * scale_y * optics.pixels_per_m_y
                raw_x = j_xx * j_xx + j_xy * j_xy
                raw_cov = j_xx * j_yx + j_xy * j_yy
                raw_y = j_yx * j_yx + j_yy * j_yy
                spread = wp.max(raw_x + raw_y, optics.min_var)
                shrink = wp.min(one, optics.max_var / spread)
                var_x = shrink * raw_x + optics.min_var
                cov = shrink * raw_cov
                var_y = shrink * raw_y + optics.min_var
                column = (x + shift * h_x - optics.window_x) * optics.pixels_per_m_x
                row = (y + shift * h_y - optics.window_y) * optics.pixels_per_m_y
                amplitude = optics.area * radiosity[c]
                widened = var_y + box
                beta = cov / widened
                sigma_y = wp.sqrt(var_y)
                sigma_x = wp.sqrt(var_x - beta * cov)
                inv_x = one / sigma_x
                inv_y = one / sigma_y
                here = True
                if wp.static(defers):
                    here = not defer(
                        b, p, c, lane, photons, grad_image.shape[1], sigma_x, sigma_y, optics, deferred, deferred_count
                    )
                if here:
                    # Adjoint of the pixels: moments of the image gradient under the footprint.
                    g_column = zero
                    g_row = zero
                    g_sigma_x = zero
                    g_sigma_y = zero
                    g_beta = zero
                    first_row = first_pixel(row, sigma_y)
                    t_below = (dtype(first_row) - row) * inv_y
                    below = cumulative(t_below)
                    below_density = density(t_below)
                    for i in range(first_row, last_pixel(row, sigma_y, grad_image.shape[2]) + 1):
                        t_above = (dtype(i + 1) - row) * inv_y
                        above = cumulative(t_above)
                        above_density = density(t_above)
                        offset = dtype(i) + half - row
                        centre = column + beta * offset
                        row_sum = zero
                        row_slope = zero
                        row_width = zero
                        first_column = first_pixel(centre, sigma_x)
                        last_column = last_pixel(centre, sigma_x, grad_image.shape[3])
                        # Each lane takes a run of neighbouring columns, so that edges are evaluated once.
                        run = (last_column - first_column + wp.static(lanes)) // wp.static(lanes)
                        first_column += lane * run
                        last_column = wp.min(last_column, first_column + run - 1)
                        t_left = (dtype(first_column) - centre) * inv_x
                        left = cumulative(t_left)
                        left_density = density(t_left)
                        for j in range(first_column, last_column + 1):
                            t_right = (dtype(j + 1) - centre) * inv_x
                            right = cumulative(t_right)
                            right_density = density(t_right)
                            g = grad_image[b, c, i, j]
                            row_sum += g * (right - left)
                            row_slope += g * (right_density - left_density)
                            row_width += g * (t_right * right_density - t_left * left_density)
                            t_left = t_right
                            left = right
                            left_density = right_density
                        share = above - below
                        g_centre = -share * row_slope * inv_x
                        g_sigma_x -= share * row_width * inv_x
                        g_column += g_centre
                        g_beta += g_centre * offset
                        g_row -= (above_density - below_density) * inv_y * row_sum + beta * g_centre
                        g_sigma_y -= (t_above * above_density - t_below * below_density) * inv_y * row_sum
                        t_below = t_above
                        below = above
                        below_density = above_density
                    # Adjoint of the covariance.
                    g_v = g_sigma_x * half * inv_x
                    g_cov = g_beta / widened - two * beta * g_v
                    g_vary = g_sigma_y * half * inv_y + beta * (beta * g_v - g_beta / widened)
                    if shrink < one:
                        g_spread = -(g_v * raw_x + g_cov * raw_cov + g_vary * raw_y) * shrink / spread
                        g_v = shrink * g_v + g_spread
                        g_cov = shrink * g_cov
                        g_vary = shrink * g_vary + g_spread
                    g_jxx = amplitude * (two * g_v * j_xx + g_cov * j_yx) * scale_x * optics.pixels_per_m_x
                    g_jxy = amplitude * (two * g_v * j_xy + g_cov * j_yy) * scale_y * optics.pixels_per_m_x
                    g_jyx = amplitude * (two * g_vary * j_yx + g_cov * j_xx) * scale_x * optics.pixels_per_m_y
                    g_jyy = amplitude * (two * g_vary * j_yy + g_cov * j_xy) * scale_y * optics.pixels_per_m_y
                    g_x = amplitude * g_column * optics.pixels_per_m_x
                    g_y = amplitude * g_row * optics.pixels_per_m_y
                    # Adjoint of the refraction.
                    a_x = g_jxx * h_x + g_jyx * h_y
                    a_y = g_jxy * h_x + g_jyy * h_y
                    g_cross = g_jxy + g_jyx
                    g_shift = g_x * h_x + g_y * h_y + g_jxx * maps[3] + g_cross * maps[4] + g_jyy * maps[5]
                    g_shift1 = two * (a_x * v_x + a_y * v_y)
                    g_hx += g_x * shift + g_jxx * w_x + g_jxy * w_y + k * a_x
                    g_hy += g_y * shift + g_jyx * w_x + g_jyy * w_y + k * a_y
                    g_vx += shift1 * a_x
                    g_vy += shift1 * a_y
                    g_hxx += g_jxx * shift
                    g_hxy += g_cross * shift
                    g_hyy += g_jyy * shift
                    g_h += g_shift * k + g_shift1 * k1
                    g_k = a_x * h_x + a_y * h_y + g_shift * thickness
                    k2 = inside_curvature(m, eta[c], k)
                    g_m += g_k * k1 + g_shift1 * thickness * k2 + optics.gap * (g_shift * e1 + g_shift1 * e2)
        g_hx += two * h_x * g_m + g_vx * maps[3] + g_vy * maps[4]
        g_hy += two * h_y * g_m + g_vx * maps[4] + g_vy * maps[5]
        g_hxx += g_vx * h_x
        g_hxy += g_vx * h_y + g_vy * h_x
        g_hyy += g_vy * h_y
        return vec6(g_h, g_hx, g_hy, g_hxx, g_hxy, g_hyy)

    @no_type_check
    @wp.kernel(enable_backward=False, module="unique")
    def splat_photons_adjoint(
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
        grad_image: wp.array4d[dtype],
        # outputs
        grad_maps: wp.array3d[dtype],
        deferred: wp.array[wp.int32],
        deferred_count: wp.array[wp.int32],
    ):
        """Gradient with respect to the surface maps [B, 6, N]; with several lanes it is added to zeros."""
        b, p, lane = wp.tid()
        gradient = gather_photon(
            b,
            p,
            0,
            grad_image.shape[1],
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
            grad_image,
            deferred,
            deferred_count,
        )
        for plane in range(6):
            if wp.static(one_lane):
                grad_maps[b, plane, p] = gradient[plane]
            else:
                wp.atomic_add(grad_maps, b, plane, p, gradient[plane])

    @no_type_check
    @wp.kernel(enable_backward=False, module="unique")
    def splat_deferred_adjoint(
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
        grad_image: wp.array4d[dtype],
        groups: wp.int32,
        deferred: wp.array[wp.int32],
        deferred_count: wp.array[wp.int32],
        # outputs
        grad_maps: wp.array3d[dtype],
    ):
        """Adds what the footprints on the list contribute to the gradient."""
        group, lane = wp.tid()
        channels = grad_image.shape[1]
        for item in range(group, deferred_count[0], groups):
            c = deferred[item] % channels
            photon = deferred[item] // channels
            b = photon // photons
            p = photon - b * photons
            gradient = gather_photon(
                b,
                p,
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
                grad_image,
                deferred,
                deferred_count,
            )
            for plane in range(6):
                wp.atomic_add(grad_maps, b, plane, p, gradient[plane])

    return SimpleNamespace(splat_photons_adjoint=splat_photons_adjoint, splat_deferred_adjoint=splat_deferred_adjoint)
