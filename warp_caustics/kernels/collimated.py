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

from warp_caustics.kernels.splat import REACH
from warp_caustics.kernels.trace import GRAZING, optics_struct


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
        inside_slope=inside_slope,
        inside_curvature=inside_curvature,
        exit_slope=exit_slope,
        footprint_sigma=footprint_sigma,
        place=place,
        defer=defer,
    )
