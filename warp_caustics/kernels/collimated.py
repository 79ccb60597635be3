"""Refraction of collimated light as scalar functions of the slope, from the relief to a footprint and back.

With parallel light the shift between relief and screen points uphill, and
Snell's law makes it a scalar times the slope:

    shift = K grad h,   K = T k(M) + gap e(M),   T = d + h,   M = 1 + |grad h|^2,
    k = (1 - eta^2) / (1 + eta R),   R^2 = eta^2 + (1 - eta^2) M   (inside the glass),
    e = u / sqrt(1 - u^2 (M - 1)),   u = ratio (1 - eta^2) / (R + eta)   (behind the bottom face),

with eta = 1/n and ratio = n / n_exit. With the Hessian H and K' = dK/dM the Jacobian is

    J = I + K H + grad h (k grad h + 2 K' H grad h)^T.

So a wavelength costs a few square roots, and the adjoint is short enough to be
written by hand. ``general.py`` is the general form, whose derivative is Warp's; both
are tested against the oracle.

What the faces let through (``fresnel.py``) and how far a lamp of finite size blurs (``lamp.py``) follow from M, T and
grad h too. Not modelled here: light that does not come along -z.
"""

from types import SimpleNamespace
from typing import Any, no_type_check

import warp as wp

from warp_caustics.kernels import specialised
from warp_caustics.kernels.effects import PLAIN, Effects
from warp_caustics.kernels.footprint import footprint_functions, footprint_struct
from warp_caustics.kernels.fresnel import fresnel_functions
from warp_caustics.kernels.general import FAR_PX, GRAZING
from warp_caustics.kernels.lamp import lamp_functions
from warp_caustics.kernels.made_once import made_once
from warp_caustics.kernels.photons import colour_struct, optics_struct
from warp_caustics.kernels.surface import photon_struct


@made_once
def collimated_functions(dtype: Any, effects: Effects = PLAIN) -> SimpleNamespace:
    """Warp functions for float32 or float64: ``refraction``, ``footprint`` and ``footprint_adjoint``."""
    has_fresnel, has_lamp = effects.fresnel, effects.lamp
    fresnel = fresnel_functions(dtype)
    transmission, transmission_slopes = fresnel.transmission, fresnel.transmission_slopes
    lamp = lamp_functions(dtype)
    lamp_covariance, lamp_covariance_adjoint = lamp.lamp_covariance, lamp.lamp_covariance_adjoint
    Optics = optics_struct(dtype)
    Photon = photon_struct(dtype)
    Colour = colour_struct(dtype)
    Footprint = footprint_struct(dtype, 0)
    functions = footprint_functions(dtype)
    plate_sigma, footprint_of = functions.plate_sigma, functions.footprint_of
    screen_covariance, screen_covariance_adjoint = functions.screen_covariance, functions.screen_covariance_adjoint
    covariance_adjoint = functions.covariance_adjoint
    zero = wp.constant(dtype(0.0))
    half = wp.constant(dtype(0.5))
    one = wp.constant(dtype(1.0))
    two = wp.constant(dtype(2.0))
    quarter = wp.constant(dtype(0.25))
    three_halves = wp.constant(dtype(1.5))
    grazing = wp.constant(dtype(GRAZING))
    far = wp.constant(dtype(FAR_PX))
    vec3 = wp.types.vector(length=3, dtype=dtype)
    vec6 = wp.types.vector(length=6, dtype=dtype)

    class Refraction:
        k: dtype  # shift per thickness and slope, inside the glass [1]
        k_m: dtype  # its derivative by M
        e: dtype  # shift per gap and slope, behind the bottom face [1]
        e_m: dtype  # its derivatives by M
        e_mm: dtype
        cosine2: dtype  # squared cosine behind the bottom face; no light leaves below GRAZING

    class Differentials:
        shift: dtype  # K [m]
        shift_m: dtype  # 2 dK/dM [m]
        w_x: dtype  # k grad h + 2 K' H grad h [1]
        w_y: dtype
        j_xx: dtype  # J times the footprint's standard deviation on the plate [px]
        j_xy: dtype
        j_yx: dtype
        j_yy: dtype
        raw: vec3  # J J^T and what the lamp adds: var_x, cov, var_y [px^2]

    Refraction = specialised(Refraction, dtype)
    Differentials = specialised(Differentials, dtype)

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
    def passed(m: dtype, eta: dtype, ratio: dtype):
        """Share of the flux that both faces let through, relative to a flat plate."""
        c = one - eta * eta
        root = wp.sqrt(eta * eta + c * m)
        g = c / (root + eta)
        sine2 = g * g * (m - one)
        cos_out = wp.sqrt(one - ratio * ratio * sine2)
        return transmission(one, root, eta) * transmission(wp.sqrt(one - sine2), cos_out, ratio)

    @no_type_check
    @wp.func
    def passed_slope(m: dtype, eta: dtype, ratio: dtype):
        """Derivative by M of the logarithm of ``passed``."""
        c = one - eta * eta
        root = wp.sqrt(eta * eta + c * m)
        g = c / (root + eta)
        sine2 = g * g * (m - one)
        sine2_m = g * g * (one - g * (m - one) / root)
        cosine = wp.sqrt(one - sine2)
        cos_out = wp.sqrt(one - ratio * ratio * sine2)
        _, by_root = transmission_slopes(one, root, eta)
        by_cosine, by_out = transmission_slopes(cosine, cos_out, ratio)
        through = by_cosine / cosine + by_out * ratio * ratio / cos_out
        return half * (by_root * c / root - through * sine2_m)

    @no_type_check
    @wp.func
    def refraction(photon: Photon, colour: Colour, optics: Optics):
        """What ``footprint`` and its adjoint both need."""
        maps = photon.maps
        m = one + maps[1] * maps[1] + maps[2] * maps[2]
        k, k_m = inside_slope(m, colour.eta)
        e, e_m, e_mm, cosine2 = exit_slope(m, colour.eta, colour.ratio)
        return Refraction(k, k_m, e, e_m, e_mm, cosine2)

    @no_type_check
    @wp.func
    def differentials(photon: Photon, eta: dtype, ratio: dtype, bent: Refraction, optics: Optics):
        """Shift between relief and screen, and the Jacobian of plate -> screen."""
        maps = photon.maps
        h_x = maps[1]
        h_y = maps[2]
        thickness = optics.base + maps[0]
        shift = thickness * bent.k + optics.gap * bent.e
        shift_m = two * (thickness * bent.k_m + optics.gap * bent.e_m)
        w_x = bent.k * h_x + shift_m * (h_x * maps[3] + h_y * maps[4])
        w_y = bent.k * h_y + shift_m * (h_x * maps[4] + h_y * maps[5])
        scale_x = plate_sigma(photon.x, optics.half_x, optics)
        scale_y = plate_sigma(photon.y, optics.half_y, optics)
        j_xx = (one + shift * maps[3] + h_x * w_x) * scale_x * optics.pixels_per_m_x
        j_xy = (shift * maps[4] + h_x * w_y) * scale_y * optics.pixels_per_m_x
        j_yx = (shift * maps[4] + h_y * w_x) * scale_x * optics.pixels_per_m_y
        j_yy = (one + shift * maps[5] + h_y * w_y) * scale_y * optics.pixels_per_m_y
        raw = vec3(j_xx * j_xx + j_xy * j_xy, j_xx * j_yx + j_xy * j_yy, j_yx * j_yx + j_yy * j_yy)
        if wp.static(has_lamp):
            raw += lamp_covariance(maps, eta, ratio, optics)
        return Differentials(shift, shift_m, w_x, w_y, j_xx, j_xy, j_yx, j_yy, raw)

    @no_type_check
    @wp.func
    def footprint(photon: Photon, colour: Colour, bent: Refraction, optics: Optics):
        """Footprint of a photon at one wavelength; amplitude 0 if no light lands."""
        found = Footprint(-far, -far, one, one, zero, zero)
        if bent.cosine2 > grazing:
            d = differentials(photon, colour.eta, colour.ratio, bent, optics)
            column = (photon.x + d.shift * photon.maps[1] - optics.window_x) * optics.pixels_per_m_x
            row = (photon.y + d.shift * photon.maps[2] - optics.window_y) * optics.pixels_per_m_y
            amplitude = optics.area * colour.radiosity
            if wp.static(has_fresnel):
                m = one + photon.maps[1] * photon.maps[1] + photon.maps[2] * photon.maps[2]
                amplitude *= passed(m, colour.eta, colour.ratio)
            found = footprint_of(column, row, screen_covariance(d.raw, optics), amplitude)
        return found

    @no_type_check
    @wp.func
    def footprint_adjoint(photon: Photon, colour: Colour, bent: Refraction, optics: Optics, f: Footprint, g: Footprint):
        """Gradient of the surface maps [6] from that of a footprint with light.

        ``g`` is for unit amplitude, as ``pixels.gather`` gives it. Without Fresnel's losses ``g.amplitude`` goes
        nowhere: the amplitude does not depend on the relief.
        """
        maps = photon.maps
        eta = colour.eta
        ratio = colour.ratio
        h_x = maps[1]
        h_y = maps[2]
        m = one + h_x * h_x + h_y * h_y
        thickness = optics.base + maps[0]
        d = differentials(photon, eta, ratio, bent, optics)
        # --- row's profile -> covariance -> J, [per px^2] and [per px]
        covariance = screen_covariance(d.raw, optics)
        g_raw = screen_covariance_adjoint(d.raw, covariance_adjoint(f, covariance[2], g), optics)
        unit_x = f.amplitude * plate_sigma(photon.x, optics.half_x, optics)
        unit_y = f.amplitude * plate_sigma(photon.y, optics.half_y, optics)
        g_jxx = (two * g_raw[0] * d.j_xx + g_raw[1] * d.j_yx) * unit_x * optics.pixels_per_m_x
        g_jxy = (two * g_raw[0] * d.j_xy + g_raw[1] * d.j_yy) * unit_y * optics.pixels_per_m_x
        g_jyx = (two * g_raw[2] * d.j_yx + g_raw[1] * d.j_xx) * unit_x * optics.pixels_per_m_y
        g_jyy = (two * g_raw[2] * d.j_yy + g_raw[1] * d.j_xy) * unit_y * optics.pixels_per_m_y
        # --- landing [per m]
        g_x = f.amplitude * g.column * optics.pixels_per_m_x
        g_y = f.amplitude * g.row * optics.pixels_per_m_y
        # --- J and landing -> K, K', k, and by those M
        a_x = g_jxx * h_x + g_jyx * h_y
        a_y = g_jxy * h_x + g_jyy * h_y
        v_x = h_x * maps[3] + h_y * maps[4]
        v_y = h_x * maps[4] + h_y * maps[5]
        g_cross = g_jxy + g_jyx
        g_shift = g_x * h_x + g_y * h_y + g_jxx * maps[3] + g_cross * maps[4] + g_jyy * maps[5]
        g_shift_m = two * (a_x * v_x + a_y * v_y)
        g_k = a_x * h_x + a_y * h_y + g_shift * thickness
        k_mm = inside_curvature(m, eta, bent.k)
        g_m = g_k * bent.k_m + g_shift_m * thickness * k_mm
        g_m += optics.gap * (g_shift * bent.e_m + g_shift_m * bent.e_mm)
        if wp.static(has_fresnel):
            g_m += f.amplitude * g.amplitude * passed_slope(m, eta, ratio)
        # --- to height, slopes and second derivatives (MAP_NAMES)
        g_vx = d.shift_m * a_x
        g_vy = d.shift_m * a_y
        gradient = vec6(
            g_shift * bent.k + g_shift_m * bent.k_m,
            g_x * d.shift
            + g_jxx * d.w_x
            + g_jxy * d.w_y
            + bent.k * a_x
            + two * h_x * g_m
            + g_vx * maps[3]
            + g_vy * maps[4],
            g_y * d.shift
            + g_jyx * d.w_x
            + g_jyy * d.w_y
            + bent.k * a_y
            + two * h_y * g_m
            + g_vx * maps[4]
            + g_vy * maps[5],
            g_jxx * d.shift + g_vx * h_x,
            g_cross * d.shift + g_vx * h_y + g_vy * h_x,
            g_jyy * d.shift + g_vy * h_y,
        )
        if wp.static(has_lamp):
            gradient += lamp_covariance_adjoint(maps, eta, ratio, f.amplitude * g_raw, optics)
        return gradient

    return SimpleNamespace(refraction=refraction, footprint=footprint, footprint_adjoint=footprint_adjoint)
