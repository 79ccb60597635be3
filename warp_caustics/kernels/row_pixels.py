"""Footprints of a row of lattice photons to pixels and back, sixteen at a time, on a CPU.

The rule for pixels is that of ``pixels.py``, for ``spline``. Weights are found for sixteen photons at once, one row of
pixels after the other, and then turned, so that each photon's four neighbouring pixels are one addition. Footprints up
to four or eight pixels wide are done here; the others, and those that reach over the sides of the image, are listed
for ``pixels.py``.
"""

from typing import Any

import warp as wp

from warp_caustics.kernels.made_once import made_once
from warp_caustics.kernels.row_refraction import FOOTPRINT_PLANE, GRADIENT_PLANE
from warp_caustics.kernels.vectors import vector_snippet

MOST_ROWS = 24
"""Footprints that reach over more rows are left to ``pixels.py``: the others of their sixteen would wait for them."""

SLOTS = 64
"""Rows of pixels of sixteen photons that wait to be added."""

_PER_BLOCK = f"""
    const size_t plane = work.shape[1];
    const int height = image.shape[2], width = image.shape[3];
    real* const pixels = image.data + (size_t(b) * image.shape[1] + channel) * height * width;
    int listed_now = 0;
    // Rounding puts edges that lie on the image's border this far beyond it; their light there is nothing.
    const real slack = sizeof(real) == 4 ? real(1.0e-4) : real(1.0e-9);
    const real widest = width < 8 ? real(-1) : real(7);
    // --- a 4 x 4 matrix turned in each group of four lanes
    auto low = [](V a, V d) __attribute__((always_inline)) -> V {{
        return __builtin_shufflevector(a, d, 0, 16, 1, 17, 4, 20, 5, 21, 8, 24, 9, 25, 12, 28, 13, 29);
    }};
    auto high = [](V a, V d) __attribute__((always_inline)) -> V {{
        return __builtin_shufflevector(a, d, 2, 18, 3, 19, 6, 22, 7, 23, 10, 26, 11, 27, 14, 30, 15, 31);
    }};
    auto low2 = [](V a, V d) __attribute__((always_inline)) -> V {{
        return __builtin_shufflevector(a, d, 0, 1, 16, 17, 4, 5, 20, 21, 8, 9, 24, 25, 12, 13, 28, 29);
    }};
    auto high2 = [](V a, V d) __attribute__((always_inline)) -> V {{
        return __builtin_shufflevector(a, d, 2, 3, 18, 19, 6, 7, 22, 23, 10, 11, 26, 27, 14, 15, 30, 31);
    }};
    auto turn = [&](V* w) __attribute__((always_inline)) {{
        const V a = low(w[0], w[1]), d = low(w[2], w[3]), e = high(w[0], w[1]), h = high(w[2], w[3]);
        w[0] = low2(a, d);
        w[1] = high2(a, d);
        w[2] = low2(e, h);
        w[3] = high2(e, h);
    }};
    {{setup}}
    struct Four {{ char columns[4]; }};
    struct Five {{ char columns[5]; }};
    struct Eight {{ char columns[8]; }};
    for (int j = begin; j < end; j += 16) {{
        real* const from = work.data + {FOOTPRINT_PLANE} * plane + j;
        const V column = load(from), row = load(from + plane);
        const V sigma_x = load(from + 2 * plane), sigma_y = load(from + 3 * plane);
        const V beta = load(from + 4 * plane);
        const V light = load(from + 5 * plane);
        // --- rows, and the columns of the outermost ones
        const V half = real(3) * sigma_x;
        const V bottom = row - real(3) * sigma_y, top = row + real(3) * sigma_y;
        const V first_row = larger(floor_of(bottom), zero);
        const V last_row = smaller(floor_of(top), V(real(height - 1)));
        const V lower = column + beta * (first_row + real(0.5) - row);
        const V upper = column + beta * (last_row + real(0.5) - row);
        const V leftmost = smaller(lower, upper) - half, rightmost = larger(lower, upper) + half;
        const auto is_lit = (light != zero) & (first_row <= last_row)
            & (rightmost >= zero) & (leftmost <= V(real(width)));
        {{start}}
        if (!__builtin_reduce_or(is_lit)) continue;
        const V size = real(2) * half;
        const auto is_inside = (leftmost >= V(-slack)) & (rightmost <= V(real(width) + slack))
            & (bottom >= V(-slack)) & (top <= V(real(height) + slack));
        const auto is_here = is_lit & is_inside & (size <= V(widest)) & (last_row - first_row < V(real({MOST_ROWS})));
        // --- the others are listed
        const auto is_other = is_lit & ~is_here;
        if (__builtin_reduce_or(is_other))
            for (int i = 0; i < 16; ++i)
                if (is_other[i]) listed.data[listed_now++] = j + i;
        {{found}}
        const int rows = (int)(__builtin_reduce_max(is_here ? last_row - first_row : V(real(-1)))) + 1;
        const V inv_x = real(0.5) / sigma_x, inv_y = real(0.5) / sigma_y;
        {{before}}
        auto work_on = [&](auto window) __attribute__((always_inline)) {{
            constexpr int C = sizeof(window.columns), W = C <= 4 ? 4 : 8;
            V below = zero;
            {{begin}}
            for (int r = 0; r < rows; ++r) {{
                const V i = first_row + real(r);
                // --- the row's share
                const V v = smaller(larger((i + one - row) * inv_y, V(real(-1.5))), V(real(1.5)));
                const V v0 = v + real(1.5), v1 = larger(v + real(0.5), zero), v2 = larger(v - real(0.5), zero);
                const V above = v0 * v0 * v0 - real(3) * (v1 * v1 * v1 - v2 * v2 * v2);
                const V offset = i + real(0.5) - row;
                const V centre = column + beta * offset;
                const V first = smaller(larger(floor_of(centre - half), zero), V(real(width - W)));
                const I at = __builtin_convertvector(smaller(i, V(real(height - 1))), I) * width
                    + __builtin_convertvector(first, I);
                {{each}}
                below = above;
            }}
            {{end}}
        }};
        if (rows > 0) {{
            const real most = __builtin_reduce_max(is_here ? size : zero);
            if (most <= real(3)) work_on(Four{{}});
            // Five of eight columns that are read: the window must not be pushed back by the image's side.
            else if (most <= real(4) && __builtin_reduce_max(is_here ? rightmost : zero) < real(width - 7))
                work_on(Five{{}});
            else work_on(Eight{{}});
        }}
    }}
    {{finish}}
    return listed_now;
"""

_ADD = {
    # Neighbours add to the same pixels, and a sum that has just been stored is slow to read again: additions wait, and
    # are made photon by photon of neighbouring blocks.
    "setup": f"""
    alignas(64) real waiting[{SLOTS} * 64];
    alignas(64) int where[{SLOTS} * 16];
    int slots = 0;
    auto flush = [&]() {{
        for (int i = 0; i < 16; ++i) {{
            const real* from = waiting + 16 * (i % 4) + 4 * (i / 4);
            for (int s = 0; s < slots; ++s) *(Q*)(pixels + where[16 * s + i]) += *(const Q*)(from + 64 * s);
        }}
        slots = 0;
    }};
    """,
    "finish": "flush();",
    "start": "",
    "found": """
        {
            // --- rows that nobody has come to yet are set to zero
            const int lowest = (int)(__builtin_reduce_min(is_lit ? first_row : V(real(height - 1))));
            const int highest = (int)(__builtin_reduce_max(is_lit ? last_row : zero));
            int* const rows_lit = lit_rows.data + 2 * b;
            if (rows_lit[0] == rows_lit[1]) rows_lit[0] = rows_lit[1] = lowest;
            auto clear = [&](int begin, int end) {
                for (int n = 0; n < image.shape[1]; ++n) {
                    real* const to = image.data + (size_t(b) * image.shape[1] + n) * height * width;
                    for (int k = begin * width; k < end * width; ++k) to[k] = real(0);
                }
            };
            if (lowest < rows_lit[0]) {
                clear(lowest, rows_lit[0]);
                rows_lit[0] = lowest;
            }
            if (highest >= rows_lit[1]) {
                clear(rows_lit[1], highest + 1);
                rows_lit[1] = highest + 1;
            }
        }
    """,
    "before": f"""
        if (slots + 2 * rows > {SLOTS}) flush();
        const V amount = is_here ? real(1.0 / 36.0) * light : zero;
    """,
    "begin": "",
    "each": """
                const V share = amount * (above - below);
                // --- shares of its pixels: the outermost edges are 0 and 1
                V w[W];
                V left = zero;
                for (int n = 1; n < C; ++n) {
                    const V t = (first + real(n) - centre) * inv_x;
                    const V u = smaller(larger(t, V(real(-1.5))), V(real(1.5)));
                    const V u0 = u + real(1.5), u1 = larger(u + real(0.5), zero), u2 = larger(u - real(0.5), zero);
                    const V right = u0 * u0 * u0 - real(3) * (u1 * u1 * u1 - u2 * u2 * u2);
                    w[n - 1] = share * (right - left);
                    left = right;
                }
                w[C - 1] = share * (real(6) - left);
                for (int n = C; n < W; ++n) w[n] = zero;
                for (int n = 0; n < W; n += 4) {
                    turn(w + n);
                    for (int i = 0; i < 4; ++i) *(V*)(waiting + 64 * slots + 16 * i) = w[n + i];
                    *(I*)(where + 16 * slots++) = at + n;
                }
    """,
    "end": "",
}

_GATHER = {
    "setup": "",
    "finish": "",
    "start": f"""
        real* const to = from + {GRADIENT_PLANE - FOOTPRINT_PLANE} * plane;
        for (int i = 0; i < 6; ++i) *(V*)(to + i * plane) = zero;
    """,
    "found": "",
    "before": "",
    "begin": """
            V below_density = zero, below_moment = zero;
            V g_column = zero, g_row = zero, g_sigma_x = zero, g_sigma_y = zero, g_beta = zero, g_amplitude = zero;
    """,
    "each": """
                const V above_density = v0 * v0 - real(3) * (v1 * v1 - v2 * v2);
                const V above_moment = v * above_density;
                // --- pixels
                V g[W];
                for (int n = 0; n < W; n += 4) {
                    for (int i = 0; i < 4; ++i) {
                        const Q a = *(const Q*)(pixels + at[i] + n), d = *(const Q*)(pixels + at[i + 4] + n);
                        const Q e = *(const Q*)(pixels + at[i + 8] + n), h = *(const Q*)(pixels + at[i + 12] + n);
                        const U ad = __builtin_shufflevector(a, d, 0, 1, 2, 3, 4, 5, 6, 7);
                        const U eh = __builtin_shufflevector(e, h, 0, 1, 2, 3, 4, 5, 6, 7);
                        g[n + i] =
                            __builtin_shufflevector(ad, eh, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
                    }
                    turn(g + n);
                }
                // --- sums over the row of G times: the share, its derivative by centre and by width; by parts
                V row_sum = real(6) * g[C - 1], row_slope = zero, row_width = zero;
                for (int n = 1; n < C; ++n) {
                    const V t = (first + real(n) - centre) * inv_x;
                    const V u = smaller(larger(t, V(real(-1.5))), V(real(1.5)));
                    const V u0 = u + real(1.5), u1 = larger(u + real(0.5), zero), u2 = larger(u - real(0.5), zero);
                    const V density = u0 * u0 - real(3) * (u1 * u1 - u2 * u2);
                    const V step = g[n] - g[n - 1];
                    row_sum -= step * (u0 * u0 * u0 - real(3) * (u1 * u1 * u1 - u2 * u2 * u2));
                    row_slope += step * density;
                    row_width += step * (u * density);
                }
                // --- the row's part of each derivative; factors of the profile at the end
                const V share = above - below;
                const V g_centre = share * row_slope;
                g_amplitude += share * row_sum;
                g_sigma_x += share * row_width;
                g_column += g_centre;
                g_beta += g_centre * offset;
                g_row += (above_density - below_density) * row_sum;
                g_sigma_y += (above_moment - below_moment) * row_sum;
                below_density = above_density;
                below_moment = above_moment;
    """,
    "end": """
            // Half a knot's distance is a standard deviation: densities are 3/6 per knot, and inv_x half of 1 / sigma.
            const V by_x = real(1.0 / 12.0) * inv_x, by_y = real(1.0 / 12.0) * inv_y;
            g_column *= by_x;
            *(V*)to = is_here ? g_column : zero;
            *(V*)(to + plane) = is_here ? -by_y * g_row - beta * g_column : zero;
            *(V*)(to + 2 * plane) = is_here ? real(2) * by_x * g_sigma_x : zero;
            *(V*)(to + 3 * plane) = is_here ? real(-2) * by_y * g_sigma_y : zero;
            *(V*)(to + 4 * plane) = is_here ? by_x * g_beta : zero;
            *(V*)(to + 5 * plane) = is_here ? real(1.0 / 36.0) * g_amplitude : zero;
    """,
}


def _text(parts: dict[str, str]) -> str:
    """The frame with its parts put in."""
    text = _PER_BLOCK
    for name, part in parts.items():
        text = text.replace("{" + name + "}", part)
    return text


@made_once
def row_pixel_functions(dtype: Any) -> tuple[Any, Any]:
    """``add_row_of_photons`` and ``gather_row_of_photons``, of some columns; how many are ``listed`` instead."""

    @wp.func_native(vector_snippet(dtype, _text(_ADD)))  # with no_type_check they would return nothing
    def add_row_of_photons(
        work: wp.array2d[dtype],
        begin: wp.int32,
        end: wp.int32,
        b: wp.int32,
        channel: wp.int32,
        # outputs
        image: wp.array4d[dtype],
        listed: wp.array[wp.int32],
        lit_rows: wp.array2d[wp.int32],
    ) -> wp.int32: ...

    @wp.func_native(vector_snippet(dtype, _text(_GATHER)))
    def gather_row_of_photons(
        work: wp.array2d[dtype],
        begin: wp.int32,
        end: wp.int32,
        b: wp.int32,
        channel: wp.int32,
        image: wp.array4d[dtype],
        # outputs
        listed: wp.array[wp.int32],
    ) -> wp.int32: ...

    return add_row_of_photons, gather_row_of_photons
