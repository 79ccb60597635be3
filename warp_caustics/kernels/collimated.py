"""Refraction of collimated light as scalar functions of the slope, and what the fused kernels share.

With parallel light the shift between relief and screen points uphill, and
Snell's law makes it a scalar times the slope:

    shift = K grad h,   K = T k(M) + gap e(M),   T = d + h,   M = 1 + |grad h|^2,
    k = (1 - eta^2) / (1 + eta R),   R^2 = eta^2 + (1 - eta^2) M   (inside the glass),
    e = u / sqrt(1 - u^2 (M - 1)),   u = ratio (1 - eta^2) / (R + eta)   (behind the bottom face),

with eta = 1/n and ratio = n / n_exit. With the Hessian H and K' = dK/dM the Jacobian is

    J = I + K H + grad h (k grad h + 2 K' H grad h)^T.

So a wavelength costs a few square roots, and the adjoint is short enough to be
written by hand (``fused_adjoint.py``). ``trace.py`` is the general form; both are
tested against the oracle.
"""

from functools import cache
from types import SimpleNamespace
from typing import Any, no_type_check

import warp as wp

from warp_caustics.kernels.splat import BOX_VARIANCE, REACH
from warp_caustics.kernels.trace import FAR_PX, GRAZING, optics_struct


@cache
def collimated_functions(dtype: Any, profile: str, is_lattice: bool) -> SimpleNamespace:
    """Warp functions for float32 or float64.

    Args:
        dtype: wp.float32 or wp.float64.
        profile: shape of the footprint, one of ``PROFILES``.
        is_lattice: photons lie on a grid (positions are its axes) instead of anywhere.
    """
    Optics = optics_struct(dtype)
    zero = wp.constant(dtype(0.0))
    half = wp.constant(dtype(0.5))
    one = wp.constant(dtype(1.0))
    two = wp.constant(dtype(2.0))
    quarter = wp.constant(dtype(0.25))
    three_halves = wp.constant(dtype(1.5))
    reach = wp.constant(dtype(REACH[profile]))
    grazing = wp.constant(dtype(GRAZING))
    box = wp.constant(dtype(BOX_VARIANCE))
    far = wp.constant(dtype(FAR_PX))
    vec5 = wp.types.vector(length=5, dtype=dtype)
    vec6 = wp.types.vector(length=6, dtype=dtype)

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
    def footprint_sigma(x: dtype, half_length: dtype, optics: Optics):
        """Standard deviation on the plate along one axis [m], squeezed near the edge of the plate."""
        sigma = optics.sigma0
        if optics.squeeze > zero:
            sigma = wp.min(sigma, (half_length - wp.abs(x)) / optics.squeeze)
        return sigma

    @no_type_check
    @wp.func
    def refraction(maps: vec6, eta: dtype, ratio: dtype):
        """k, dk/dM, e, de/dM, d2e/dM2 and the squared cosine behind the bottom face."""
        m = one + maps[1] * maps[1] + maps[2] * maps[2]
        k, k1 = inside_slope(m, eta)
        e, e1, e2, q = exit_slope(m, eta, ratio)
        return vec6(k, k1, e, e1, e2, q)

    @no_type_check
    @wp.func
    def footprint(x: dtype, y: dtype, maps: vec6, slopes: vec6, radiosity: dtype, optics: Optics):
        """Column, row, sigma_x of a row's profile, sigma_y, beta [px] and amplitude; amplitude 0 if no light lands."""
        found = vec6(-far, -far, one, one, zero, zero)
        if slopes[5] > grazing:
            h_x = maps[1]
            h_y = maps[2]
            k = slopes[0]
            thickness = optics.base + maps[0]
            scale_x = footprint_sigma(x, optics.half_x, optics)
            scale_y = footprint_sigma(y, optics.half_y, optics)
            shift = thickness * k + optics.gap * slopes[2]
            shift1 = two * (thickness * slopes[1] + optics.gap * slopes[3])
            w_x = k * h_x + shift1 * (h_x * maps[3] + h_y * maps[4])
            w_y = k * h_y + shift1 * (h_x * maps[4] + h_y * maps[5])
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
            beta = cov / (var_y + box)
            column = (x + shift * h_x - optics.window_x) * optics.pixels_per_m_x
            row = (y + shift * h_y - optics.window_y) * optics.pixels_per_m_y
            found = vec6(column, row, wp.sqrt(var_x - beta * cov), wp.sqrt(var_y), beta, optics.area * radiosity)
        return found

    @no_type_check
    @wp.func
    def footprint_adjoint(
        x: dtype,
        y: dtype,
        maps: vec6,
        eta: dtype,
        slopes: vec6,
        radiosity: dtype,
        optics: Optics,
        beta: dtype,
        inv_x: dtype,
        inv_y: dtype,
        moments: vec5,
    ):
        """Gradient of the surface maps from that of a footprint with light: column, row, sigma_x, sigma_y, beta."""
        h_x = maps[1]
        h_y = maps[2]
        m = one + h_x * h_x + h_y * h_y
        thickness = optics.base + maps[0]
        v_x = h_x * maps[3] + h_y * maps[4]
        v_y = h_x * maps[4] + h_y * maps[5]
        scale_x = footprint_sigma(x, optics.half_x, optics)
        scale_y = footprint_sigma(y, optics.half_y, optics)
        k = slopes[0]
        k1 = slopes[1]
        e1 = slopes[3]
        e2 = slopes[4]
        shift = thickness * k + optics.gap * slopes[2]
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
        amplitude = optics.area * radiosity
        # Adjoint of the covariance.
        g_cov_of_beta = moments[4] / (shrink * raw_y + optics.min_var + box)
        g_v = moments[2] * half * inv_x
        g_cov = g_cov_of_beta - two * beta * g_v
        g_vary = moments[3] * half * inv_y + beta * (beta * g_v - g_cov_of_beta)
        if shrink < one:
            g_spread = -(g_v * raw_x + g_cov * raw_cov + g_vary * raw_y) * shrink / spread
            g_v = shrink * g_v + g_spread
            g_cov = shrink * g_cov
            g_vary = shrink * g_vary + g_spread
        g_jxx = amplitude * (two * g_v * j_xx + g_cov * j_yx) * scale_x * optics.pixels_per_m_x
        g_jxy = amplitude * (two * g_v * j_xy + g_cov * j_yy) * scale_y * optics.pixels_per_m_x
        g_jyx = amplitude * (two * g_vary * j_yx + g_cov * j_xx) * scale_x * optics.pixels_per_m_y
        g_jyy = amplitude * (two * g_vary * j_yy + g_cov * j_xy) * scale_y * optics.pixels_per_m_y
        g_x = amplitude * moments[0] * optics.pixels_per_m_x
        g_y = amplitude * moments[1] * optics.pixels_per_m_y
        # Adjoint of the refraction.
        a_x = g_jxx * h_x + g_jyx * h_y
        a_y = g_jxy * h_x + g_jyy * h_y
        g_cross = g_jxy + g_jyx
        g_shift = g_x * h_x + g_y * h_y + g_jxx * maps[3] + g_cross * maps[4] + g_jyy * maps[5]
        g_shift1 = two * (a_x * v_x + a_y * v_y)
        g_k = a_x * h_x + a_y * h_y + g_shift * thickness
        k2 = inside_curvature(m, eta, k)
        g_m = g_k * k1 + g_shift1 * thickness * k2 + optics.gap * (g_shift * e1 + g_shift1 * e2)
        g_vx = shift1 * a_x
        g_vy = shift1 * a_y
        return vec6(
            g_shift * k + g_shift1 * k1,
            g_x * shift + g_jxx * w_x + g_jxy * w_y + k * a_x + two * h_x * g_m + g_vx * maps[3] + g_vy * maps[4],
            g_y * shift + g_jyx * w_x + g_jyy * w_y + k * a_y + two * h_y * g_m + g_vx * maps[4] + g_vy * maps[5],
            g_jxx * shift + g_vx * h_x,
            g_cross * shift + g_vx * h_y + g_vy * h_x,
            g_jyy * shift + g_vy * h_y,
        )

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

    return SimpleNamespace(
        refraction=refraction, footprint=footprint, footprint_adjoint=footprint_adjoint, place=place, defer=defer
    )
