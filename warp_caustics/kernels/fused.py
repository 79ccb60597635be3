"""The whole photon in one kernel, for collimated light: surface, refraction, footprint, pixels.

With parallel light the shift between relief and screen points uphill, and
Snell's law makes it a scalar times the slope:

    shift = K grad h,   K = T k(M) + gap e(M),   T = d + h,   M = 1 + |grad h|^2,
    k = (1 - eta^2) / (1 + eta R),   R^2 = eta^2 + (1 - eta^2) M   (inside the glass),
    e = u / sqrt(1 - u^2 (M - 1)),   u = ratio (1 - eta^2) / (R + eta)   (behind the bottom face),

with eta = 1/n and ratio = n / n_exit. With the Hessian H and K' = dK/dM the Jacobian is

    J = I + K H + grad h (k grad h + 2 K' H grad h)^T.

So a wavelength costs two square roots, and the adjoint is short enough to be
written by hand: no records are stored, and photons need no atomics but the
splat's own. ``trace.py`` is the general form; both are tested against the oracle.
"""

from functools import cache
from types import SimpleNamespace
from typing import Any, no_type_check

import warp as wp

from warp_caustics.kernels.splat import BOX_VARIANCE, PROFILE_FACTORIES, REACH
from warp_caustics.kernels.surface import surface_functions
from warp_caustics.kernels.trace import GRAZING, optics_struct


@cache
def fused_kernels(dtype: Any, profile: str, lanes: int, is_lattice: bool, defers: bool) -> SimpleNamespace:
    """Kernels ``splat_photons``, ``splat_deferred`` and their adjoints.

    Args:
        dtype: wp.float32 or wp.float64.
        profile: shape of the footprint, one of ``PROFILES``.
        lanes: threads that share a footprint's columns; 1 for compact ones, 8 for wide ones on a GPU.
        is_lattice: photons lie on a grid (positions are its axes) instead of anywhere.
        defers: wide footprints are left to the ``deferred`` kernels, which share each among their lanes.
    """
    cumulative, density = PROFILE_FACTORIES[profile](dtype)
    surface_at = surface_functions(dtype).surface_at
    vec6 = wp.types.vector(length=6, dtype=dtype)
    Optics = optics_struct(dtype)
    zero = wp.constant(dtype(0.0))
    half = wp.constant(dtype(0.5))
    one = wp.constant(dtype(1.0))
    two = wp.constant(dtype(2.0))
    quarter = wp.constant(dtype(0.25))
    three_halves = wp.constant(dtype(1.5))
    reach = wp.constant(dtype(REACH[profile]))
    box = wp.constant(dtype(BOX_VARIANCE))
    grazing = wp.constant(dtype(GRAZING))
    one_lane = lanes == 1

    @no_type_check
    @wp.func
    def inside_slope(m: dtype, eta: dtype):
        """k and dk/dM."""
        c = one - eta * eta
        root = wp.sqrt(eta * eta + c * m)
        k = c / (one + eta * root)
        return k, -half * k * k * eta / root

    @no_type_check
    @wp.func
    def inside_curvature(m: dtype, eta: dtype, k: dtype):
        """d2k/dM2."""
        c = one - eta * eta
        root = wp.sqrt(eta * eta + c * m)
        return k * k * eta / (root * root) * (half * k * eta + quarter * c / root)

    @no_type_check
    @wp.func
    def exit_slope(m: dtype, eta: dtype, ratio: dtype):
        """e, de/dM, d2e/dM2 and the squared cosine behind the bottom face."""
        c = one - eta * eta
        root = wp.sqrt(eta * eta + c * m)
        g = c / (root + eta)
        u = ratio * g
        u1 = -half * u * g / root
        g1 = -half * g * g / root
        root1 = half * c / root
        u2 = -half * (u1 * g + u * g1 - u * g * root1 / root) / root
        s = u * u * (m - one)
        s1 = two * u * u1 * (m - one) + u * u
        s2 = two * (u1 * u1 + u * u2) * (m - one) + two * two * u * u1
        q = one - s
        z = one / wp.sqrt(wp.max(q, grazing))
        z1 = half * s1 * z * z * z
        z2 = half * s2 * z * z * z + three_halves * s1 * z * z * z1
        return u * z, u1 * z + u * z1, u2 * z + two * u1 * z1 + u * z2, q

    @no_type_check
    @wp.func
    def first_pixel(centre: dtype, sigma: dtype):
        return wp.max(wp.int32(wp.floor(centre - reach * sigma)), 0)

    @no_type_check
    @wp.func
    def last_pixel(centre: dtype, sigma: dtype, count: wp.int32):
        return wp.min(wp.int32(wp.floor(centre + reach * sigma)), count - 1)

    @no_type_check
    @wp.func
    def footprint_sigma(x: dtype, half_length: dtype, optics: Optics):
        """Standard deviation on the plate along one axis [m], squeezed near the edge of the plate."""
        sigma = optics.sigma0
        if optics.squeeze > zero:
            sigma = wp.min(sigma, (half_length - wp.abs(x)) / optics.squeeze)
        return sigma

    @no_type_check
    @wp.func
    def place(positions: wp.array2d[dtype], p: wp.int32, columns: wp.int32):
        """Starting point (x, y) of photon p [m]."""
        x = zero
        y = zero
        if wp.static(is_lattice):
            x = positions[0, p % columns]
            y = positions[1, p // columns]
        else:
            x = positions[p, 0]
            y = positions[p, 1]
        return x, y

    @no_type_check
    @wp.func
    def defer(
        b: wp.int32,
        p: wp.int32,
        c: wp.int32,
        lane: wp.int32,
        photons: wp.int32,
        channels: wp.int32,
        sigma_x: dtype,
        sigma_y: dtype,
        optics: Optics,
        deferred: wp.array[wp.int32],
        deferred_count: wp.array[wp.int32],
    ):
        """Put a footprint that covers many pixels on the list for many threads; False if it is small.

        Otherwise a launch would wait for the few photons with footprints of thousands of pixels.
        """
        is_put_off = False
        if (two * reach * sigma_x + one) * (two * reach * sigma_y + one) > optics.wide_pixels:
            is_put_off = True
            if lane == 0:
                deferred[wp.atomic_add(deferred_count, 0, 1)] = (b * photons + p) * channels + c
        return is_put_off

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

    return SimpleNamespace(
        splat_photons=splat_photons,
        splat_photons_adjoint=splat_photons_adjoint,
        splat_deferred=splat_deferred,
        splat_deferred_adjoint=splat_deferred_adjoint,
    )
