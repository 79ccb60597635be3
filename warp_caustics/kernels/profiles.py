"""The shape of a footprint along one axis: distribution function and density of two profiles.

Both have unit variance and a continuous, strictly bounded distribution function,
so that an image does not jump when a window moves on by a pixel (with a plain
cut, a finite difference across such a jump is wrong by any amount):

- ``gaussian``: ends at 4 standard deviations, renormalised and widened so that
  energy and covariance stay exact. The paper's choice.
- ``spline``: quadratic B-spline, ends at 3 standard deviations. Copies at a
  distance of two standard deviations add up to a constant, so a photon lattice
  with s = sqrt(2 pi) shows no ripple; a Gaussian of that width leaves 1.4 %.
  No exponentials.
"""

import math
from typing import Any, no_type_check

import warp as wp

from warp_caustics.kernels.made_once import made_once

PROFILES = ("gaussian", "spline")

GAUSSIAN_REACH = 4.0
"""Half-width of the Gaussian in standard deviations; 6e-5 of its energy would lie beyond."""

NORMALISATION = 1.0 / math.erf(GAUSSIAN_REACH / math.sqrt(2.0))
"""One over the energy of the Gaussian within its reach."""

WIDENING = 1.0 / (
    1.0 - 2.0 * GAUSSIAN_REACH * NORMALISATION * math.exp(-(GAUSSIAN_REACH**2) / 2) / math.sqrt(2.0 * math.pi)
)
"""One over the variance that the truncated standard Gaussian keeps."""

REACH = {"gaussian": GAUSSIAN_REACH * math.sqrt(WIDENING), "spline": 3.0}
"""Half-width of each profile in standard deviations."""


ERF_POLE = 0.3275911
ERF_TERMS = (0.254829592, -0.284496736, 1.421413741, -1.453152027, 1.061405429)
"""erf(x) = 1 - (a1 r + ... + a5 r^5) exp(-x^2), r = 1 / (1 + p x), for x >= 0, to 1.5e-7 (Abramowitz and Stegun,
Handbook of Mathematical Functions, 7.1.26)."""


def _brief_gaussian_profile(dtype: Any) -> tuple[Any, Any]:
    """The same in half the operations, to 1e-7 of the whole: both need the one exponential."""
    reach = wp.constant(dtype(GAUSSIAN_REACH))
    narrowing = wp.constant(dtype(1.0 / math.sqrt(WIDENING)))
    zero = wp.constant(dtype(0.0))
    one = wp.constant(dtype(1.0))
    half = wp.constant(dtype(0.5))
    half_normalisation = wp.constant(dtype(0.5 * NORMALISATION))
    peak = wp.constant(dtype(NORMALISATION / math.sqrt(2.0 * math.pi * WIDENING)))
    pole = wp.constant(dtype(ERF_POLE * math.sqrt(0.5)))
    a1, a2, a3, a4, a5 = (wp.constant(dtype(a)) for a in ERF_TERMS)

    @no_type_check
    @wp.func
    def cumulative(t: dtype):
        u = t * narrowing
        far = wp.abs(u)
        r = one / (one + pole * far)
        beyond = r * (a1 + r * (a2 + r * (a3 + r * (a4 + r * a5)))) * wp.exp(-half * u * u)
        part = wp.where(far < reach, half_normalisation * (one - beyond), half)
        return half + wp.where(u < zero, -part, part)

    @no_type_check
    @wp.func
    def density(t: dtype):
        u = t * narrowing
        return wp.where(wp.abs(u) < reach, peak * wp.exp(-half * u * u), zero)

    return cumulative, density


def _gaussian_profile(dtype: Any) -> tuple[Any, Any]:
    reach = wp.constant(dtype(GAUSSIAN_REACH))
    narrowing = wp.constant(dtype(1.0 / math.sqrt(WIDENING)))
    half = wp.constant(dtype(0.5))
    half_normalisation = wp.constant(dtype(0.5 * NORMALISATION))
    inv_sqrt2 = wp.constant(dtype(math.sqrt(0.5)))
    peak = wp.constant(dtype(NORMALISATION / math.sqrt(2.0 * math.pi * WIDENING)))

    @no_type_check
    @wp.func
    def cumulative(t: dtype):
        """Distribution function of the truncated Gaussian at t standard deviations."""
        return half + half_normalisation * wp.erf(wp.clamp(t * narrowing, -reach, reach) * inv_sqrt2)

    @no_type_check
    @wp.func
    def density(t: dtype):
        """Its derivative."""
        u = t * narrowing
        value = t - t
        if wp.abs(u) < reach:
            value = peak * wp.exp(-half * u * u)
        return value

    return cumulative, density


def _spline_profile(dtype: Any) -> tuple[Any, Any]:
    edge = wp.constant(dtype(1.5))
    half = wp.constant(dtype(0.5))
    zero = wp.constant(dtype(0.0))
    three = wp.constant(dtype(3.0))
    sixth = wp.constant(dtype(1.0 / 6.0))
    quarter = wp.constant(dtype(0.25))

    @no_type_check
    @wp.func
    def cumulative(t: dtype):
        """Distribution function of the quadratic B-spline at t standard deviations (knots 2 apart)."""
        u = wp.clamp(half * t, -edge, edge)
        a = u + edge
        b = wp.max(u + half, zero)
        c = wp.max(u - half, zero)
        return sixth * (a * a * a - three * (b * b * b - c * c * c))

    @no_type_check
    @wp.func
    def density(t: dtype):
        """Its derivative."""
        u = wp.clamp(half * t, -edge, edge)
        a = u + edge
        b = wp.max(u + half, zero)
        c = wp.max(u - half, zero)
        return quarter * (a * a - three * (b * b - c * c))

    return cumulative, density


@made_once
def profile_functions(dtype: Any, profile: str, is_brief: bool = False) -> tuple[Any, Any]:
    """Warp functions ``cumulative`` and ``density`` of a profile, for float32 or float64; to 1e-7 if ``is_brief``."""
    if is_brief and profile == "gaussian":
        return _brief_gaussian_profile(dtype)
    return {"gaussian": _gaussian_profile, "spline": _spline_profile}[profile](dtype)
