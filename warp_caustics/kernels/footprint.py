"""A footprint from the plate to the screen: its covariance, and the numbers that ``pixels.py`` spreads over pixels.

On the plate a footprint has the standard deviation sigma0 along both axes, on the
screen the covariance sigma0^2 J J^T (J: Jacobian of plate -> screen), shrunk where
it is very large, plus a constant. Functions that Warp does not differentiate have
their adjoint beside them.
"""

from types import SimpleNamespace
from typing import Any, no_type_check

import warp as wp

from warp_caustics.kernels import specialised
from warp_caustics.kernels.made_once import made_once
from warp_caustics.kernels.photons import optics_struct

BOX_VARIANCE = 1.0 / 12.0
"""Variance of the uniform distribution over a pixel [px^2]."""


@made_once
def footprint_struct(dtype: Any, width: int) -> Any:
    """Struct of a footprint; with a width, of that many wavelengths' footprints as vectors [width]."""
    numbers = wp.types.vector(length=width, dtype=dtype) if width else dtype

    class Footprint:
        column: numbers  # centre [px]
        row: numbers
        sigma_x: numbers  # standard deviation of a row's profile, sqrt(v) of pixels.py [px]
        sigma_y: numbers  # of the rows' shares, sqrt(c) [px]
        beta: numbers  # columns the centre moves on per row [1]
        amplitude: numbers  # irradiance x pixels [W/m^2]; 0 if no light lands

    return specialised(Footprint, dtype, width)


@made_once
def footprint_functions(dtype: Any) -> SimpleNamespace:
    """Warp functions for float32 or float64; covariances are vec3 (var_x, cov, var_y) [px^2]."""
    Optics = optics_struct(dtype)
    Footprint = footprint_struct(dtype, 0)
    vec3 = wp.types.vector(length=3, dtype=dtype)
    zero = wp.constant(dtype(0.0))
    half = wp.constant(dtype(0.5))
    one = wp.constant(dtype(1.0))
    two = wp.constant(dtype(2.0))
    box = wp.constant(dtype(BOX_VARIANCE))

    @no_type_check
    @wp.func
    def plate_sigma(x: dtype, half_length: dtype, optics: Optics):
        """Standard deviation on the plate along one axis [m], squeezed near the edge of the plate."""
        sigma = optics.sigma0
        if optics.squeeze > zero:
            sigma = wp.min(sigma, (half_length - wp.abs(x)) / optics.squeeze)
        return sigma

    @no_type_check
    @wp.func
    def screen_covariance(raw: vec3, optics: Optics):
        """Covariance on the screen from that of the differentials alone."""
        shrink = wp.min(one, optics.max_var / wp.max(raw[0] + raw[2], optics.min_var))
        return vec3(shrink * raw[0] + optics.min_var, shrink * raw[1], shrink * raw[2] + optics.min_var)

    @no_type_check
    @wp.func
    def screen_covariance_adjoint(raw: vec3, g: vec3, optics: Optics):
        """Gradient with respect to ``raw`` from that with respect to the covariance on the screen."""
        spread = wp.max(raw[0] + raw[2], optics.min_var)
        shrink = wp.min(one, optics.max_var / spread)
        g_raw = g
        if shrink < one:
            g_spread = -wp.dot(g, raw) * shrink / spread
            g_raw = vec3(shrink * g[0] + g_spread, shrink * g[1], shrink * g[2] + g_spread)
        return g_raw

    @no_type_check
    @wp.func
    def footprint_of(column: dtype, row: dtype, covariance: vec3, amplitude: dtype):
        """Footprint with that centre [px] and covariance."""
        beta = covariance[1] / (covariance[2] + box)
        sigma_x = wp.sqrt(covariance[0] - beta * covariance[1])
        return Footprint(column, row, sigma_x, wp.sqrt(covariance[2]), beta, amplitude)

    @no_type_check
    @wp.func
    def covariance_adjoint(f: Footprint, var_y: dtype, g: Footprint):
        """Gradient with respect to the covariance from that with respect to sigma_x, sigma_y and beta."""
        g_beta = g.beta / (var_y + box)
        g_var_x = g.sigma_x * half / f.sigma_x
        g_cov = g_beta - two * f.beta * g_var_x
        g_var_y = g.sigma_y * half / f.sigma_y + f.beta * (f.beta * g_var_x - g_beta)
        return vec3(g_var_x, g_cov, g_var_y)

    return SimpleNamespace(
        plate_sigma=plate_sigma,
        screen_covariance=screen_covariance,
        screen_covariance_adjoint=screen_covariance_adjoint,
        footprint_of=footprint_of,
        covariance_adjoint=covariance_adjoint,
    )
