"""Footprints integrated over pixels, and the adjoint of that.

A footprint has its centre at (x, y) and covariance [[a, b], [b, c]] in pixels;
pixel (i, j) covers [j, j + 1] x [i, i + 1] and receives the footprint's
integral over that square. Along rows the integral is exact. Along columns it
is that of the row's conditional profile, whose centre and variance are

    x_i = x + beta (i + 1/2 - y),   beta = b / (c + 1/12),   v = a - beta b:

1/12 is the variance of a pixel's box. This keeps energy, mean and covariance
of the footprint for every size and is exact for footprints without tilt. A
point-sampled Gaussian loses up to 1 % of its energy at a quarter pixel.

Two profiles, both of unit variance and with a continuous, strictly bounded
distribution function, so that an image does not jump when a window moves on by
a pixel (with a plain cut, a finite difference across such a jump is wrong by
any amount):

- ``gaussian``: ends at 4 standard deviations, renormalised and widened so that
  energy and covariance stay exact. The paper's choice.
- ``spline``: quadratic B-spline, ends at 3 standard deviations. Copies at a
  distance of two standard deviations add up to a constant, so a photon lattice
  with s = sqrt(2 pi) shows no ripple; a Gaussian of that width leaves 1.4 %.
  No exponentials.

The adjoint is a gather: no atomics, and deterministic.
"""

import math
from functools import cache
from types import SimpleNamespace
from typing import Any, no_type_check

import warp as wp

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

BOX_VARIANCE = 1.0 / 12.0
"""Variance of the uniform distribution over a pixel [px^2]."""


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


PROFILE_FACTORIES = {"gaussian": _gaussian_profile, "spline": _spline_profile}
"""Distribution function and density of each profile, as Warp functions."""


@cache
def window_functions(dtype: Any, profile: str) -> tuple[Any, Any]:
    """First and last pixel that a footprint touches along an axis, within the image."""
    reach = wp.constant(dtype(REACH[profile]))

    @no_type_check
    @wp.func
    def first_pixel(centre: dtype, sigma: dtype):
        return wp.max(wp.int32(wp.floor(centre - reach * sigma)), 0)

    @no_type_check
    @wp.func
    def last_pixel(centre: dtype, sigma: dtype, count: wp.int32):
        return wp.min(wp.int32(wp.floor(centre + reach * sigma)), count - 1)

    return first_pixel, last_pixel


_CPU_ROW = """
#if !defined(__CUDA_ARCH__)
    typedef {real} real;
    typedef real reals __attribute__((ext_vector_type(8), aligned(sizeof(real))));
    const reals zero = {{0, 0, 0, 0, 0, 0, 0, 0}};
    const reals one = {{1, 1, 1, 1, 1, 1, 1, 1}};
    const reals steps = {{0, 1, 2, 3, 4, 5, 6, 7}};
    const int width = image.shape[3];
    auto* row = image.data + ((size_t(b) * image.shape[1] + c) * image.shape[2] + i) * width;
    const real half_inv = real(0.5) * inv_sigma;
    {start}
    for (int j = first; j <= last; j += 7) {{
        reals u = (steps + (real(j) - centre)) * half_inv;
        u = u < real(-1.5) * one ? real(-1.5) * one : u;
        u = u > real(1.5) * one ? real(1.5) * one : u;
        const reals p = u + real(1.5);
        reals q = u + real(0.5);
        q = q > zero ? q : zero;
        reals r = u - real(0.5);
        r = r > zero ? r : zero;
        const reals below = p * p * p - real(3) * (q * q * q - r * r * r);
        const reals shares = __builtin_shufflevector(below, below, 1, 2, 3, 4, 5, 6, 7, 7) - below;
        {each}
    }}
    {end}
#else
    {nothing}
#endif
"""
"""Seven pixels of a row at a time: their eight edges fit a vector register, and the eighth share is zero."""

_CPU_ADD = {
    "start": "",
    "each": """
        const reals light = (amplitude * real(1.0 / 6.0)) * shares;
        if (j + 8 <= width) *(reals*)(row + j) += light;
        else for (int k = 0; j + k < width; ++k) row[j + k] += light[k];
    """,
    "end": "",
    "nothing": "",
}

_CPU_GATHER = {
    "start": "reals sum = zero, slope = zero, breadth = zero;",
    "each": """
        reals g = zero;
        if (j + 8 <= width) g = *(const reals*)(row + j);
        else for (int k = 0; j + k < width; ++k) g[k] = row[j + k];
        const reals density = p * p - real(3) * (q * q - r * r);
        const reals moment = u * density;
        sum += g * shares;
        slope += g * (__builtin_shufflevector(density, density, 1, 2, 3, 4, 5, 6, 7, 7) - density);
        breadth += g * (__builtin_shufflevector(moment, moment, 1, 2, 3, 4, 5, 6, 7, 7) - moment);
    """,
    "end": """
        const auto s4 = sum.lo + sum.hi, d4 = slope.lo + slope.hi, m4 = breadth.lo + breadth.hi;
        const auto s2 = s4.lo + s4.hi, d2 = d4.lo + d4.hi, m2 = m4.lo + m4.hi;
        return wp::vec_t<3, real>(
            real(1.0 / 6.0) * (s2[0] + s2[1]), real(0.25) * (d2[0] + d2[1]), real(0.5) * (m2[0] + m2[1])
        );
    """,
    "nothing": "return wp::vec_t<3, {real}>();",
}


@cache
def cpu_row_functions(dtype: Any) -> tuple[Any, Any]:
    """A row of a ``spline`` footprint in a CPU's vector registers: ``add_row`` and ``gather_row``.

    LLVM leaves the loops over pixels scalar, since their windows are short and of any length.
    """
    vec3 = wp.types.vector(length=3, dtype=dtype)
    real = {wp.float32: "float", wp.float64: "double"}[dtype]

    def snippet(parts: dict[str, str]) -> str:
        return _CPU_ROW.format(real=real, **(parts | {"nothing": parts["nothing"].format(real=real)}))

    @no_type_check
    @wp.func_native(snippet(_CPU_ADD))
    def add_row(
        image: wp.array4d[dtype],
        b: wp.int32,
        c: wp.int32,
        i: wp.int32,
        first: wp.int32,
        last: wp.int32,
        centre: dtype,
        inv_sigma: dtype,
        amplitude: dtype,
    ): ...

    @wp.func_native(snippet(_CPU_GATHER))  # with no_type_check it would return nothing
    def gather_row(
        image: wp.array4d[dtype],
        b: wp.int32,
        c: wp.int32,
        i: wp.int32,
        first: wp.int32,
        last: wp.int32,
        centre: dtype,
        inv_sigma: dtype,
    ) -> vec3: ...

    return add_row, gather_row


@cache
def splat_kernels(dtype: Any, profile: str) -> SimpleNamespace:
    """Kernels for float32 or float64 and a profile: ``splat`` and ``splat_adjoint``."""
    cumulative, density = PROFILE_FACTORIES[profile](dtype)
    first_pixel, last_pixel = window_functions(dtype, profile)
    zero = wp.constant(dtype(0.0))
    half = wp.constant(dtype(0.5))
    one = wp.constant(dtype(1.0))
    two = wp.constant(dtype(2.0))
    box = wp.constant(dtype(BOX_VARIANCE))

    @no_type_check
    @wp.kernel(enable_backward=False, module="unique")
    def splat(
        records: wp.array4d[dtype],
        # outputs
        image: wp.array4d[dtype],
    ):
        """Add every footprint of records [B, C, 6, N] (RECORD_NAMES) to image [B, C, H, W] [W/m^2]."""
        b, c, p = wp.tid()
        amplitude = records[b, c, 5, p]
        if amplitude != zero:
            x = records[b, c, 0, p]
            y = records[b, c, 1, p]
            cov = records[b, c, 3, p]
            var_y = records[b, c, 4, p]
            beta = cov / (var_y + box)
            sigma_y = wp.sqrt(var_y)
            sigma_x = wp.sqrt(records[b, c, 2, p] - beta * cov)
            inv_x = one / sigma_x
            inv_y = one / sigma_y
            first_row = first_pixel(y, sigma_y)
            below = cumulative((dtype(first_row) - y) * inv_y)
            for i in range(first_row, last_pixel(y, sigma_y, image.shape[2]) + 1):
                above = cumulative((dtype(i + 1) - y) * inv_y)
                share = amplitude * (above - below)
                below = above
                row_x = x + beta * (dtype(i) + half - y)
                first_column = first_pixel(row_x, sigma_x)
                left = cumulative((dtype(first_column) - row_x) * inv_x)
                for j in range(first_column, last_pixel(row_x, sigma_x, image.shape[3]) + 1):
                    right = cumulative((dtype(j + 1) - row_x) * inv_x)
                    wp.atomic_add(image, b, c, i, j, share * (right - left))
                    left = right

    @no_type_check
    @wp.kernel(enable_backward=False, module="unique")
    def splat_adjoint(
        records: wp.array4d[dtype],
        grad_image: wp.array4d[dtype],
        # outputs
        grad_records: wp.array4d[dtype],
    ):
        """Adjoint of ``splat``: gradient with respect to the records from that with respect to the image."""
        b, c, p = wp.tid()
        amplitude = records[b, c, 5, p]
        grad_x = zero
        grad_y = zero
        grad_var_x = zero
        grad_cov = zero
        grad_var_y = zero
        grad_amplitude = zero
        if amplitude != zero:
            x = records[b, c, 0, p]
            y = records[b, c, 1, p]
            cov = records[b, c, 3, p]
            var_y = records[b, c, 4, p]
            widened = var_y + box
            beta = cov / widened
            sigma_y = wp.sqrt(var_y)
            sigma_x = wp.sqrt(records[b, c, 2, p] - beta * cov)
            inv_x = one / sigma_x
            inv_y = one / sigma_y
            grad_sigma_x = zero
            grad_sigma_y = zero
            grad_beta = zero
            first_row = first_pixel(y, sigma_y)
            t_below = (dtype(first_row) - y) * inv_y
            below = cumulative(t_below)
            below_density = density(t_below)
            for i in range(first_row, last_pixel(y, sigma_y, grad_image.shape[2]) + 1):
                t_above = (dtype(i + 1) - y) * inv_y
                above = cumulative(t_above)
                above_density = density(t_above)
                offset = dtype(i) + half - y
                row_x = x + beta * offset
                # Sums over the row of G times: the share, its derivative by centre and by width.
                row_sum = zero
                row_slope = zero
                row_width = zero
                first_column = first_pixel(row_x, sigma_x)
                t_left = (dtype(first_column) - row_x) * inv_x
                left = cumulative(t_left)
                left_density = density(t_left)
                for j in range(first_column, last_pixel(row_x, sigma_x, grad_image.shape[3]) + 1):
                    t_right = (dtype(j + 1) - row_x) * inv_x
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
                grad_amplitude += share * row_sum
                grad_row_x = -share * row_slope * inv_x
                grad_sigma_x -= share * row_width * inv_x
                grad_x += grad_row_x
                grad_beta += grad_row_x * offset
                grad_y -= (above_density - below_density) * inv_y * row_sum + beta * grad_row_x
                grad_sigma_y -= (t_above * above_density - t_below * below_density) * inv_y * row_sum
                t_below = t_above
                below = above
                below_density = above_density
            grad_v = amplitude * grad_sigma_x * half * inv_x
            grad_beta = amplitude * grad_beta
            grad_x = amplitude * grad_x
            grad_y = amplitude * grad_y
            grad_var_x = grad_v
            grad_cov = grad_beta / widened - two * beta * grad_v
            grad_var_y = amplitude * grad_sigma_y * half * inv_y + beta * (beta * grad_v - grad_beta / widened)
        grad_records[b, c, 0, p] = grad_x
        grad_records[b, c, 1, p] = grad_y
        grad_records[b, c, 2, p] = grad_var_x
        grad_records[b, c, 3, p] = grad_cov
        grad_records[b, c, 4, p] = grad_var_y
        grad_records[b, c, 5, p] = grad_amplitude

    return SimpleNamespace(splat=splat, splat_adjoint=splat_adjoint)
