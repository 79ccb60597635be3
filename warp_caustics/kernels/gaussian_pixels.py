"""Gaussian footprints to pixels and back in a CPU's vector registers: a footprint's row is one register or two.

The rule for pixels and the profile are those of ``pixels.py`` and ``profiles.py``. The truncated distribution function
and its density are polynomials here, since Warp's ``erf`` and ``exp`` take one number at a time: of u^2 in u's range,
exact to rounding.
"""

import math
from typing import Any, no_type_check

import numpy as np
import warp as wp

from warp_caustics.kernels.made_once import made_once
from warp_caustics.kernels.profiles import GAUSSIAN_REACH, NORMALISATION, REACH, WIDENING
from warp_caustics.kernels.vectors import vector_snippet
from warp_caustics.types import FloatArray

TERMS = {wp.float32: 13, wp.float64: 25}
"""Terms of the polynomials: one less, and they would be off by 2e-7 in float32, three less, by 1e-14 in float64."""


def _powers(values: FloatArray) -> str:
    """Horner's rule in C++ of the polynomial through values at Chebyshev's points, a vector s of [-1, 1]."""
    fit = np.polynomial.chebyshev.chebfit(_points(len(values)), values, len(values) - 1)
    first, *rest = [f"V(real({a!r}))" for a in np.polynomial.chebyshev.cheb2poly(fit)[::-1].tolist()]
    text = first
    for a in rest:
        text = f"({text} * s + {a})"
    return text


def _points(count: int) -> FloatArray:
    """Chebyshev's points in (-1, 1)."""
    points: FloatArray = np.cos((np.arange(count) + 0.5) * np.pi / count)
    return points


@made_once
def _profile(dtype: Any) -> str:
    """C++ of ``cumulative``, less a half, and ``density`` at u; standard deviations of the Gaussian that is cut."""
    count = TERMS[dtype]
    u = GAUSSIAN_REACH * np.sqrt((1.0 + _points(count)) / 2.0)
    half_erf = np.array([0.5 * NORMALISATION * math.erf(x / math.sqrt(2.0)) / x for x in u])
    density = NORMALISATION / math.sqrt(2.0 * math.pi) * np.exp(-u * u / 2.0)
    return f"""
    const real reach = real({REACH["gaussian"]!r}), narrow = real({1.0 / math.sqrt(WIDENING)!r});
    const V most = real({GAUSSIAN_REACH!r});
    auto within = [&](V u) __attribute__((always_inline)) -> V {{ return smaller(larger(u, -most), most); }};
    auto place = [](V u) __attribute__((always_inline)) -> V {{
        return u * u * real({2.0 / GAUSSIAN_REACH**2!r}) - real(1);
    }};
    auto cumulative = [](V u, V s) __attribute__((always_inline)) -> V {{ return u * {_powers(half_erf)}; }};
    auto density = [](V s) __attribute__((always_inline)) -> V {{ return {_powers(density)}; }};
    auto next = [](V a) __attribute__((always_inline)) -> V {{
        return __builtin_shufflevector(a, a, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 15);
    }};
"""


_ROWS = """
    const int height = image.shape[2], width = image.shape[3];
    const size_t stride = width;
    real* const pixels = image.data + (size_t(b) * image.shape[1] + c) * height * stride;
    const real inv_x = narrow / sigma_x, inv_y = narrow / sigma_y, half = reach * sigma_x;
    const V steps = lane_number * inv_x;
    const real past = real(15) * inv_x;
    auto bounded = [](real a, int low, int high) -> int {
        return (int)(a < real(low) ? real(low) : a > real(high) ? real(high) : a);
    };
    const int first_row = bounded(__builtin_floor(row - reach * sigma_y), 0, height);
    const int last_row = bounded(__builtin_floor(row + reach * sigma_y), -1, height - 1);
    // Fifteen pixels at a time, whose sixteen edges are a vector: rows, then the columns of each.
    alignas(64) int from[16], to[16];
    alignas(64) real start[16];
    SETUP
    for (int i0 = first_row; i0 <= last_row; i0 += 15) {
        const V edge = (lane_number + (real(i0) - row)) * inv_y;
        const V v = within(edge), below = cumulative(v, place(v));
        const V share = next(below) - below;
        const V offset = lane_number + (real(i0) + real(0.5) - row);
        const V centre = column + beta * offset;
        const V first = smaller(larger(floor_of(centre - half), zero), V(real(width)));
        const V last = smaller(larger(floor_of(centre + half), -one), V(real(width - 1)));
        *(V*)start = (first - centre) * inv_x;
        *(I*)from = __builtin_convertvector(first, I);
        *(I*)to = __builtin_convertvector(last, I);
        const int rows = last_row - i0 < 14 ? last_row - i0 + 1 : 15;
        PER_ROWS
        for (int r = 0; r < rows; ++r) {
            real* const line = pixels + (i0 + r) * stride;
            V edges = steps + start[r];
            PER_ROW
            for (int j = from[r]; j <= to[r]; j += 15, edges += past) {
                const V u = within(edges), s = place(u), left = cumulative(u, s);
                PER_PIXELS
            }
        }
    }
"""


def _text(setup: str, per_rows: str, per_row: str, per_pixels: str) -> str:
    parts = {"SETUP": setup, "PER_ROWS": per_rows, "PER_PIXELS": per_pixels, "PER_ROW": per_row}
    text = _ROWS
    for name, part in parts.items():
        text = text.replace(name, part)
    return text


_ADD = _text(
    "alignas(64) real light_of[16];",
    "*(V*)light_of = amplitude * share;",
    "const real light_here = light_of[r];",
    """
                const V light = light_here * (next(left) - left);
                if (j + 16 <= width) *(V*)(line + j) += light;
                else for (int k = 0; j + k < width; ++k) line[j + k] += light[k];
    """,
)

_GATHER = _text(
    """
    alignas(64) real share_of[16], moved[16], bent[16], broad[16];
    V g_column = zero, g_row = zero, g_sigma_x = zero, g_sigma_y = zero, g_beta = zero, g_amplitude = zero;
    auto sum_of = [](V a) __attribute__((always_inline)) -> real {
        const U eight = a.lo + a.hi;
        const Q four = eight.lo + eight.hi;
        return (four[0] + four[2]) + (four[1] + four[3]);
    };
    const auto is_pixel = lane_number < V(real(15));
    """,
    """
        const V high = ((edge < most) & (edge > -most)) ? density(place(v)) : zero, moment = v * high;
        *(V*)share_of = share;
        *(V*)moved = share * offset;
        *(V*)bent = next(high) - high;
        *(V*)broad = next(moment) - moment;
    """,
    "const real share_here = share_of[r], moved_here = moved[r], bent_here = bent[r], broad_here = broad[r];",
    """
                V g = zero;
                if (j + 16 <= width) g = is_pixel ? load(line + j) : zero;
                else for (int k = 0; k < 15 && j + k < width; ++k) g[k] = line[j + k];
                // --- sums of G times differences between edges, by parts
                const V before = __builtin_shufflevector(
                    g, zero, 16, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14
                );
                const V step = before - g;
                const V sum = step * left;
                const V slope = ((edges < most) & (edges > -most)) ? step * density(s) : zero;
                g_amplitude += share_here * sum;
                g_row += bent_here * sum;
                g_sigma_y += broad_here * sum;
                g_column += share_here * slope;
                g_beta += moved_here * slope;
                g_sigma_x += share_here * (u * slope);
    """,
)

_GATHERED = """
    const real by_column = -inv_x * sum_of(g_column);
    wp::vec_t<6, real> found;
    found[0] = by_column;
    found[1] = -inv_y * sum_of(g_row) - beta * by_column;
    found[2] = -sum_of(g_sigma_x) / sigma_x;
    found[3] = -sum_of(g_sigma_y) / sigma_y;
    found[4] = -inv_x * sum_of(g_beta);
    found[5] = sum_of(g_amplitude);
    return found;
#else
    return wp::vec_t<6, real>();
"""


@made_once
def gaussian_functions(dtype: Any) -> tuple[Any, Any]:
    """``add_gaussian``: a footprint to the image [B, C, H, W]; ``gather_gaussian``: the gradient [6] with respect to
    one of unit amplitude, in the order of ``footprint_struct``."""
    vec6 = wp.types.vector(length=6, dtype=dtype)

    @no_type_check
    @wp.func_native(vector_snippet(dtype, _profile(dtype) + _ADD))
    def add_gaussian(
        image: wp.array4d[dtype],
        b: wp.int32,
        c: wp.int32,
        column: dtype,
        row: dtype,
        sigma_x: dtype,
        sigma_y: dtype,
        beta: dtype,
        amplitude: dtype,
    ): ...

    @wp.func_native(vector_snippet(dtype, _profile(dtype) + _GATHER + _GATHERED))  # with no_type_check: no result
    def gather_gaussian(
        image: wp.array4d[dtype],
        b: wp.int32,
        c: wp.int32,
        column: dtype,
        row: dtype,
        sigma_x: dtype,
        sigma_y: dtype,
        beta: dtype,
    ) -> vec6: ...

    return add_gaussian, gather_gaussian
