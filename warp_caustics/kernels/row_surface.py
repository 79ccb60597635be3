"""The relief under a row of lattice photons, and the adjoint of that, on a CPU.

All photons of a lattice row share the weights along y, so that 4 x 4 coefficients become three rows: of the spline,
its slope and its curvature along y. Between two samples each is a cubic of the place t in the cell. Its four powers are
found once for a cell, and all of its photons, neighbours in the row, are evaluated together.
"""

from typing import Any, no_type_check

import warp as wp

from warp_caustics.kernels.made_once import made_once
from warp_caustics.kernels.vectors import vector_snippet

CELL_PLANES = 15
"""Rows of the scratch memory of cells: three of coefficients, and twelve powers."""

_ROWS = """
    const int taps = coefficients.shape[2];
    const size_t stride = by_cell.shape[1];
    real* const rows = by_cell.data;
    real* const powers = by_cell.data + 3 * stride;
    const size_t plane = work.shape[1];
    const real* const t_of = across.data;
"""

_MAPS = (
    _ROWS
    + """
    // --- along y: value, slope and curvature, per metre
    {
        const real* __restrict c = coefficients.data + (size_t(b) * taps + cell_row) * taps;
        real* __restrict to = rows;
        for (int j = first_cell; j < end_cell + 3; ++j) {
            const real c0 = c[j], c1 = c[taps + j], c2 = c[2 * taps + j], c3 = c[3 * taps + j];
            to[j] = weights[0] * c0 + weights[1] * c1 + weights[2] * c2 + weights[3] * c3;
            to[stride + j] = slopes[0] * c0 + slopes[1] * c1 + slopes[2] * c2 + slopes[3] * c3;
            to[2 * stride + j] = curvatures[0] * c0 + curvatures[1] * c1 + curvatures[2] * c2 + curvatures[3] * c3;
        }
    }
    // --- powers of t in each cell
    for (int m = 0; m < 3; ++m) {
        const real* __restrict a = rows + m * stride;
        real* __restrict to = powers + 4 * m * stride;
        for (int k = first_cell; k < end_cell; ++k) {
            const real a0 = a[k], a1 = a[k + 1], a2 = a[k + 2], a3 = a[k + 3];
            to[k] = real(1.0 / 6.0) * (a0 + real(4) * a1 + a2);
            to[stride + k] = real(0.5) * (a2 - a0);
            to[2 * stride + k] = real(0.5) * (a0 - real(2) * a1 + a2);
            to[3 * stride + k] = real(1.0 / 6.0) * (a3 - a0) + real(0.5) * (a1 - a2);
        }
    }
    // --- photons of each cell; what is written beyond them, the next cell writes over
    const real per = samples_per_m_x, per2 = per * per;
    for (int k = first_cell; k < end_cell; ++k) {
        for (int j = first_photon.data[k]; j < first_photon.data[k + 1]; j += 8) {
            const U t = load8(t_of + j);
            const real* p = powers + k;
            real* to = work.data + j;
            U low = p[2 * stride], high = p[3 * stride];
            *(U*)to = p[0] + t * (p[stride] + t * (low + t * high));
            *(U*)(to + plane) = per * (p[stride] + t * (real(2) * low + t * (real(3) * high)));
            *(U*)(to + 3 * plane) = per2 * (real(2) * low + t * (real(6) * high));
            p += 4 * stride;
            low = p[2 * stride], high = p[3 * stride];
            *(U*)(to + 2 * plane) = p[0] + t * (p[stride] + t * (low + t * high));
            *(U*)(to + 4 * plane) = per * (p[stride] + t * (real(2) * low + t * (real(3) * high)));
            p += 4 * stride;
            *(U*)(to + 5 * plane) = p[0] + t * (p[stride] + t * (p[2 * stride] + t * p[3 * stride]));
        }
    }
"""
)

_MAPS_ADJOINT = (
    _ROWS
    + """
    const int cells = taps - 3;
    // --- photons of each cell, to powers, to coefficients along x
    for (int m = 0; m < 3; ++m)
        for (int j = 0; j < taps; ++j) rows[m * stride + j] = real(0);
    const U none = real(0);
    const U per = samples_per_m_x, per2 = per * per;
    auto total = [](U a) __attribute__((always_inline)) -> real {
        const Q four = a.lo + a.hi;
        return (four[0] + four[2]) + (four[1] + four[3]);
    };
    for (int k = 0; k < cells; ++k) {
        const int end = first_photon.data[k + 1];
        int j = first_photon.data[k];
        if (j >= end) continue;
        U s0 = none, s1 = none, s2 = none, s3 = none;
        U u0 = none, u1 = none, u2 = none, u3 = none;
        U v0 = none, v1 = none, v2 = none, v3 = none;
        for (; j < end; j += 8) {
            const U t = load8(t_of + j);
            const real* from = work.data + first_plane * plane + j;
            const auto is_here = lane_number8 < U(real(end - j));
            const U h = is_here ? load8(from) : none;
            const U hx = is_here ? per * load8(from + plane) : none;
            const U hy = is_here ? load8(from + 2 * plane) : none;
            const U hxx = is_here ? real(2) * per2 * load8(from + 3 * plane) : none;
            const U hxy = is_here ? per * load8(from + 4 * plane) : none;
            const U hyy = is_here ? load8(from + 5 * plane) : none;
            const U t2 = t * t;
            s0 += h;
            s1 += t * h + hx;
            s2 += t2 * h + real(2) * t * hx + hxx;
            s3 += t * (t2 * h + real(3) * (t * hx + hxx));
            u0 += hy;
            u1 += t * hy + hxy;
            u2 += t2 * hy + real(2) * t * hxy;
            u3 += t2 * (t * hy + real(3) * hxy);
            v0 += hyy;
            v1 += t * hyy;
            v2 += t2 * hyy;
            v3 += t * (t2 * hyy);
        }
        auto spread = [&](real* to, U w0, U w1, U w2, U w3) __attribute__((always_inline)) {
            const real p0 = real(1.0 / 6.0) * total(w0), p1 = real(0.5) * total(w1);
            const real p2 = real(0.5) * total(w2), p3 = real(1.0 / 6.0) * total(w3);
            to[0] += p0 - p1 + p2 - p3;
            to[1] += real(4) * p0 - real(2) * p2 + real(3) * p3;
            to[2] += p0 + p1 + p2 - real(3) * p3;
            to[3] += p3;
        };
        spread(rows + k, s0, s1, s2, s3);
        spread(rows + stride + k, u0, u1, u2, u3);
        spread(rows + 2 * stride + k, v0, v1, v2, v3);
    }
    // --- along y
    const real* __restrict from = rows;
    real* __restrict c = grad_coefficients.data + (size_t(b) * taps + cell_row) * taps;
    for (int r = 0; r < 4; ++r)
        for (int j = 0; j < taps; ++j)
            c[r * taps + j] +=
                weights[r] * from[j] + slopes[r] * from[stride + j] + curvatures[r] * from[2 * stride + j];
"""
)


_BOTH_WAYS = """
    const int rows = matrix.shape[0], inner = matrix.shape[1];
    const real* const left = matrix.data;
    const real* const right = transposed.data;
    auto add_scaled = [](real* __restrict to, const real* __restrict from, real by, int n) {
        for (int j = 0; j < n; ++j) to[j] += by * from[j];
    };
    auto from_to = [](int i, int n) -> int { return i < 0 ? 0 : i > n ? n : i; };
    for (int i = 0; i < rows; ++i) {
        real* const half_way = work.data;
        real* const to = found.data + (size_t(b) * rows + i) * rows;
        for (int j = 0; j < inner; ++j) half_way[j] = real(0);
        for (int j = 0; j < rows; ++j) to[j] = real(0);
        // --- entries lie around the diagonal, which goes through the middle of both
        const int middle = i + (inner - rows) / 2;
        for (int k = from_to(middle - reach, inner); k < from_to(middle + reach + 1, inner); ++k)
            add_scaled(half_way, planes.data + (size_t(b) * inner + k) * inner, left[size_t(i) * inner + k], inner);
        for (int k = 0; k < inner; ++k) {
            if (half_way[k] == real(0)) continue;  // bare plate, or where a change is none
            const int across = k + (rows - inner) / 2;
            const int begin = from_to(across - reach, rows), end = from_to(across + reach + 1, rows);
            add_scaled(to + begin, right + size_t(k) * rows + begin, half_way[k], end - begin);
        }
    }
"""


@made_once
def both_ways_function(dtype: Any) -> Any:
    """``both_ways``: matrix [R, K] @ planes[b] [K, K] @ transposed [K, R]; scratch memory of K numbers.

    Entries farther than ``reach`` from the diagonal are taken as zero. That of a matrix with more rows than columns, or
    fewer, begins and ends beside its corners, by half of the difference.

    torch's product of matrices this small wakes its threads, which then wait for more on the cores that splat.
    """

    @no_type_check
    @wp.func_native(vector_snippet(dtype, _BOTH_WAYS))
    def both_ways(
        matrix: wp.array2d[dtype],
        transposed: wp.array2d[dtype],
        planes: wp.array3d[dtype],
        b: wp.int32,
        reach: wp.int32,
        work: wp.array[dtype],
        # outputs
        found: wp.array3d[dtype],
    ): ...

    return both_ways


@made_once
def row_surface_functions(dtype: Any) -> tuple[Any, Any]:
    """``row_maps`` and ``row_maps_adjoint``.

    Both take scratch memory for cells [CELL_PLANES, n + 4], the row of coefficients that comes first, the weights of
    the four rows and of their first and second derivatives along y [per m], where in its cell each photon lies (row 0
    of ``across``), and the first photon of each cell [n + 2]. Maps are those of some cells, n + 1 in all, and of the
    photons in these.
    """
    vec4 = wp.types.vector(length=4, dtype=dtype)

    @no_type_check
    @wp.func_native(vector_snippet(dtype, _MAPS))
    def row_maps(
        coefficients: wp.array3d[dtype],
        b: wp.int32,
        cell_row: wp.int32,
        weights: vec4,
        slopes: vec4,
        curvatures: vec4,
        samples_per_m_x: dtype,
        across: wp.array2d[dtype],
        first_photon: wp.array[wp.int32],
        first_cell: wp.int32,
        end_cell: wp.int32,
        by_cell: wp.array2d[dtype],
        # outputs: planes 0 to 5, MAP_NAMES
        work: wp.array2d[dtype],
    ): ...

    @no_type_check
    @wp.func_native(vector_snippet(dtype, _MAPS_ADJOINT))
    def row_maps_adjoint(
        coefficients: wp.array3d[dtype],
        b: wp.int32,
        cell_row: wp.int32,
        weights: vec4,
        slopes: vec4,
        curvatures: vec4,
        samples_per_m_x: dtype,
        across: wp.array2d[dtype],
        first_photon: wp.array[wp.int32],
        by_cell: wp.array2d[dtype],
        work: wp.array2d[dtype],
        first_plane: wp.int32,
        # outputs
        grad_coefficients: wp.array3d[dtype],
    ): ...

    return row_maps, row_maps_adjoint
