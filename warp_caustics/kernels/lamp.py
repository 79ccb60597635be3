"""What a lamp of finite size adds to a footprint, for collimated light along -z, and the adjoint of that.

Light comes from a disc of directions, w = (s, -1) to first order, with the variance v of s along each axis. The
landing point moves by J_dir ds, so the covariance on the screen grows by v J_dir J_dir^T. From Snell's law, with the
names of ``collimated.py`` and g = (1 - eta^2) / (R + eta), a = eta / (eta + g), u = ratio g and
z = 1 / sqrt(1 - u^2 (M - 1)):

    J_dir = alpha I + beta grad h grad h^T,
    alpha = T a + gap eta ratio z,
    beta = -T a^2 g / R + gap eta ratio z (e^2 (1 - (M - 1) g / R) - g / R),   e = u z,
    J_dir J_dir^T = alpha^2 I + (2 alpha beta + beta^2 (M - 1)) grad h grad h^T.

``general.py`` has the same for any light, by the product rule.
"""

from types import SimpleNamespace
from typing import Any, no_type_check

import warp as wp

from warp_caustics.kernels import specialised
from warp_caustics.kernels.made_once import made_once
from warp_caustics.kernels.photons import optics_struct


@made_once
def lamp_functions(dtype: Any) -> SimpleNamespace:
    """Warp functions for float32 or float64: ``lamp_covariance`` and ``lamp_covariance_adjoint``."""
    Optics = optics_struct(dtype)
    zero = wp.constant(dtype(0.0))
    half = wp.constant(dtype(0.5))
    one = wp.constant(dtype(1.0))
    two = wp.constant(dtype(2.0))
    vec3 = wp.types.vector(length=3, dtype=dtype)
    vec6 = wp.types.vector(length=6, dtype=dtype)

    class Spread:
        alpha: dtype  # [m]
        beta: dtype
        alpha_t: dtype  # derivatives by the thickness T [1]
        beta_t: dtype
        alpha_m: dtype  # by M [m]
        beta_m: dtype

    Spread = specialised(Spread, dtype)

    @no_type_check
    @wp.func
    def spread(m: dtype, thickness: dtype, eta: dtype, ratio: dtype, gap: dtype):
        c = one - eta * eta
        root = wp.sqrt(eta * eta + c * m)
        g = c / (root + eta)
        a = eta / (eta + g)
        bend = g / root
        side = one - bend * (m - one)
        u2 = ratio * ratio * g * g
        z = one / wp.sqrt(one - u2 * (m - one))
        e2 = u2 * z * z
        y = e2 * side - bend
        behind = gap * eta * ratio
        # --- by M
        a_m = half * a * a * g * bend / eta
        bend_m = -half * bend * (bend + c / (root * root))
        side_m = -bend_m * (m - one) - bend
        z_m = half * u2 * side * z * z * z
        e2_m = two * e2 * (z_m / z - half * bend)
        y_m = e2_m * side + e2 * side_m - bend_m
        return Spread(
            thickness * a + behind * z,
            behind * z * y - thickness * a * a * bend,
            a,
            -a * a * bend,
            thickness * a_m + behind * z_m,
            behind * (z_m * y + z * y_m) - thickness * a * (two * a_m * bend + a * bend_m),
        )

    @no_type_check
    @wp.func
    def lamp_covariance(maps: vec6, eta: dtype, ratio: dtype, optics: Optics):
        """Covariance (var_x, cov, var_y) [px^2] that the lamp adds."""
        x = maps[1] * optics.pixels_per_m_x
        y = maps[2] * optics.pixels_per_m_y
        m = one + maps[1] * maps[1] + maps[2] * maps[2]
        d = spread(m, optics.base + maps[0], eta, ratio, optics.gap)
        plain = optics.lamp_var * d.alpha * d.alpha
        along = optics.lamp_var * d.beta * (two * d.alpha + d.beta * (m - one))
        return vec3(
            plain * optics.pixels_per_m_x * optics.pixels_per_m_x + along * x * x,
            along * x * y,
            plain * optics.pixels_per_m_y * optics.pixels_per_m_y + along * y * y,
        )

    @no_type_check
    @wp.func
    def lamp_covariance_adjoint(maps: vec6, eta: dtype, ratio: dtype, g: vec3, optics: Optics):
        """Gradient of the surface maps [6] from that of the covariance."""
        x = maps[1] * optics.pixels_per_m_x
        y = maps[2] * optics.pixels_per_m_y
        m = one + maps[1] * maps[1] + maps[2] * maps[2]
        d = spread(m, optics.base + maps[0], eta, ratio, optics.gap)
        scale_x = optics.pixels_per_m_x
        scale_y = optics.pixels_per_m_y
        g_plain = optics.lamp_var * (g[0] * scale_x * scale_x + g[2] * scale_y * scale_y)
        g_along = optics.lamp_var * (g[0] * x * x + g[1] * x * y + g[2] * y * y)
        g_alpha = two * (d.alpha * g_plain + d.beta * g_along)
        g_beta = two * (d.alpha + d.beta * (m - one)) * g_along
        g_m = d.beta * d.beta * g_along + g_alpha * d.alpha_m + g_beta * d.beta_m
        along = optics.lamp_var * d.beta * (two * d.alpha + d.beta * (m - one))
        return vec6(
            g_alpha * d.alpha_t + g_beta * d.beta_t,
            along * (two * g[0] * x + g[1] * y) * scale_x + two * maps[1] * g_m,
            along * (two * g[2] * y + g[1] * x) * scale_y + two * maps[2] * g_m,
            zero,
            zero,
            zero,
        )

    return SimpleNamespace(lamp_covariance=lamp_covariance, lamp_covariance_adjoint=lamp_covariance_adjoint)
