"""Height, slopes and second derivatives of the relief where photons start."""

from types import SimpleNamespace
from typing import Any, no_type_check

import warp as wp

from warp_caustics.kernels import specialised
from warp_caustics.kernels.made_once import made_once
from warp_caustics.kernels.photons import photons_struct


@made_once
def surface_functions(dtype: Any) -> SimpleNamespace:
    """Warp functions for float32 or float64: ``surface_at`` and the weights of four neighbouring coefficients."""
    Photons = photons_struct(dtype)
    vec4 = wp.types.vector(length=4, dtype=dtype)
    vec6 = wp.types.vector(length=6, dtype=dtype)
    one = wp.constant(dtype(1.0))
    two = wp.constant(dtype(2.0))
    three = wp.constant(dtype(3.0))
    four = wp.constant(dtype(4.0))
    half = wp.constant(dtype(0.5))
    sixth = wp.constant(dtype(1.0 / 6.0))
    zero = wp.constant(dtype(0.0))

    @no_type_check
    @wp.func
    def spline_weights(t: dtype):
        """Cubic B-spline weights of the four coefficients around a point, t in [0, 1)."""
        s = one - t
        return vec4(
            s * s * s * sixth,
            ((three * t - three * two) * t * t + four) * sixth,
            (((three - three * t) * t + three) * t + one) * sixth,
            t * t * t * sixth,
        )

    @no_type_check
    @wp.func
    def spline_slopes(t: dtype):
        """First derivatives of the weights, per sample pitch."""
        s = one - t
        return vec4(
            -s * s * half,
            (three * t - four) * t * half,
            ((two - three * t) * t + one) * half,
            t * t * half,
        )

    @no_type_check
    @wp.func
    def spline_curvatures(t: dtype):
        """Second derivatives of the weights, per squared sample pitch."""
        return vec4(one - t, three * t - two, one - three * t, t)

    @no_type_check
    @wp.func
    def cell_at(x: dtype, y: dtype, photons: Photons):
        """Column and row of the cell between samples that (x, y) [m] is in, and the place in it [samples]."""
        n = photons.samples
        u = x * photons.samples_per_m_x + half * dtype(n) - half
        v = y * photons.samples_per_m_y + half * dtype(n) - half
        column = wp.clamp(wp.int32(wp.floor(u)), -1, n - 1)
        row = wp.clamp(wp.int32(wp.floor(v)), -1, n - 1)
        return column, row, u - dtype(column), v - dtype(row)

    @no_type_check
    @wp.func
    def surface_at(coefficients: wp.array3d[dtype], b: wp.int32, x: dtype, y: dtype, photons: Photons):
        """Height, slopes and second derivatives (MAP_NAMES) at (x, y) [m] from coefficients [B, n + 4, n + 4]."""
        samples_per_m_x = photons.samples_per_m_x
        samples_per_m_y = photons.samples_per_m_y
        # --- place, and the weights of its four neighbours per axis
        column, row, tx, ty = cell_at(x, y, photons)
        wx = spline_weights(tx)
        wy = spline_weights(ty)
        sx = spline_slopes(tx)
        sy = spline_slopes(ty)
        cx = spline_curvatures(tx)
        cy = spline_curvatures(ty)
        # --- tensor product, derivatives per sample pitch
        h = zero
        h_x = zero
        h_y = zero
        h_xx = zero
        h_xy = zero
        h_yy = zero
        for k in range(4):
            value = zero
            slope = zero
            curvature = zero
            for l in range(4):
                c = coefficients[b, row + 1 + k, column + 1 + l]
                value += wx[l] * c
                slope += sx[l] * c
                curvature += cx[l] * c
            h += wy[k] * value
            h_x += wy[k] * slope
            h_y += sy[k] * value
            h_xx += wy[k] * curvature
            h_xy += sy[k] * slope
            h_yy += cy[k] * value
        # --- per metre
        return vec6(
            h,
            h_x * samples_per_m_x,
            h_y * samples_per_m_y,
            h_xx * samples_per_m_x * samples_per_m_x,
            h_xy * samples_per_m_x * samples_per_m_y,
            h_yy * samples_per_m_y * samples_per_m_y,
        )

    return SimpleNamespace(
        cell_at=cell_at,
        surface_at=surface_at,
        spline_weights=spline_weights,
        spline_slopes=spline_slopes,
        spline_curvatures=spline_curvatures,
    )


@made_once
def photon_struct(dtype: Any) -> Any:
    """Struct of a photon: where it starts, and the relief there."""
    vec6 = wp.types.vector(length=6, dtype=dtype)

    class Photon:
        x: dtype  # [m]
        y: dtype
        maps: vec6  # MAP_NAMES

    return specialised(Photon, dtype)


@made_once
def photon_function(dtype: Any, is_lattice: bool) -> Any:
    """``photon_at``: photon p over relief b; a lattice's positions are its axes, x in row 0 and y in row 1."""
    Photons = photons_struct(dtype)
    Photon = photon_struct(dtype)
    surface_at = surface_functions(dtype).surface_at
    zero = wp.constant(dtype(0.0))

    @no_type_check
    @wp.func
    def photon_at(coefficients: wp.array3d[dtype], photons: Photons, b: wp.int32, p: wp.int32):
        x = zero
        y = zero
        if wp.static(is_lattice):
            x = photons.positions[0, p % photons.columns]
            y = photons.positions[1, p // photons.columns]
        else:
            x = photons.positions[p, 0]
            y = photons.positions[p, 1]
        return Photon(x, y, surface_at(coefficients, b, x, y, photons))

    return photon_at


@made_once
def surface_kernels(dtype: Any) -> SimpleNamespace:
    """Kernels for float32 or float64: ``gather_surface``, ``prefilter_rows``, ``prefilter_columns``."""
    Photons = photons_struct(dtype)
    surface_at = surface_functions(dtype).surface_at
    zero = wp.constant(dtype(0.0))

    @no_type_check
    @wp.kernel(module="unique")
    def gather_surface(
        coefficients: wp.array3d[dtype],
        photons: Photons,
        # outputs
        maps: wp.array3d[dtype],
    ):
        """Surface maps [B, 6, N] from spline coefficients [B, n + 4, n + 4] at positions [N, 2] [m]."""
        b, p = wp.tid()
        found = surface_at(coefficients, b, photons.positions[p, 0], photons.positions[p, 1], photons)
        for plane in range(6):
            maps[b, plane, p] = found[plane]

    @no_type_check
    @wp.kernel(module="unique")
    def prefilter_columns(
        matrix: wp.array2d[dtype],
        heights: wp.array3d[dtype],
        # outputs
        filtered: wp.array3d[dtype],
    ):
        """filtered[b] = matrix @ heights[b]: samples to coefficients along the rows' axis."""
        b, i, j = wp.tid()
        total = zero
        for k in range(heights.shape[1]):
            total += matrix[i, k] * heights[b, k, j]
        filtered[b, i, j] = total

    @no_type_check
    @wp.kernel(module="unique")
    def prefilter_rows(
        matrix: wp.array2d[dtype],
        filtered: wp.array3d[dtype],
        # outputs
        coefficients: wp.array3d[dtype],
    ):
        """coefficients[b] = filtered[b] @ matrix.T: samples to coefficients along the columns' axis."""
        b, i, j = wp.tid()
        total = zero
        for k in range(filtered.shape[2]):
            total += filtered[b, i, k] * matrix[j, k]
        coefficients[b, i, j] = total

    return SimpleNamespace(
        gather_surface=gather_surface, prefilter_columns=prefilter_columns, prefilter_rows=prefilter_rows
    )
