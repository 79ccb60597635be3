"""Footprints integrated over pixels, and the adjoint of that: what every kernel that splats shares.

A footprint has its centre at (x, y) and covariance [[a, b], [b, c]] in pixels;
pixel (i, j) covers [j, j + 1] x [i, i + 1] and receives the footprint's
integral over that square. Along rows the integral is exact. Along columns it
is that of the row's conditional profile, whose centre and variance are

    x_i = x + beta (i + 1/2 - y),   beta = b / (c + 1/12),   v = a - beta b:

1/12 is the variance of a pixel's box. This keeps energy, mean and covariance
of the footprint for every size and is exact for footprints without tilt. A
point-sampled Gaussian loses up to 1 % of its energy at a quarter pixel.

The sums over pixels carry values from one to the next, so their adjoint is
written by hand: a gather without atomics. Nothing here knows where footprints
come from.
"""

from types import SimpleNamespace
from typing import Any, no_type_check

import warp as wp

from warp_caustics.kernels.fixed_point import counting_function, sum_type
from warp_caustics.kernels.footprint import footprint_struct
from warp_caustics.kernels.gaussian_pixels import gaussian_functions
from warp_caustics.kernels.made_once import made_once
from warp_caustics.kernels.native import cpu_row_functions, pixel_adder
from warp_caustics.kernels.profiles import REACH, profile_functions

COLUMN_LANES = 8
"""Threads that share the columns of a footprint where more of them work on it: the others take other rows. Folds make
footprints long in any direction."""


def lanes_apart(lanes: int) -> tuple[int, int]:
    """Of threads that share a footprint, how many share its rows and how many its columns."""
    rows = max(1, lanes // COLUMN_LANES)
    return rows, lanes // rows


@made_once
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


@made_once
def adding_functions(
    dtype: Any, profile: str, width: int, lanes: int, is_packed: bool, in_registers: bool, is_fixed: bool = False
) -> SimpleNamespace:
    """``row_window`` and ``add_rows``: the footprints of ``width`` wavelengths to pixels.

    Args:
        dtype: wp.float32 or wp.float64.
        profile: shape of the footprint, one of ``PROFILES``.
        width: wavelengths added at once, over the union of their windows.
        lanes: threads that share the columns of a row, and the rows (:func:`lanes_apart`).
        is_packed: images are [B, H, W, PACK], all wavelengths side by side, instead of [B, C, H, W].
        in_registers: rows go through a CPU's vector registers; for one wavelength and one lane.
        is_fixed: images are whole numbers, for sums in any order; not in registers, not packed.
    """
    if in_registers and profile == "gaussian":
        return _adding_gaussians(dtype)
    cumulative, _ = profile_functions(dtype, profile, is_brief=dtype is wp.float32)
    first_pixel, last_pixel = window_functions(dtype, profile)
    add_row, _ = cpu_row_functions(dtype)
    add_pixel = pixel_adder(dtype, width)
    counted, sums = counting_function(dtype, is_fixed), sum_type(dtype, is_fixed)
    Footprints = footprint_struct(dtype, width)
    vector = wp.types.vector(length=width, dtype=dtype)
    half = wp.constant(dtype(0.5))
    one = wp.constant(dtype(1.0))
    row_lanes, column_lanes = lanes_apart(lanes)

    @no_type_check
    @wp.func
    def window(centre: vector, sigma: vector, size: wp.int32):
        """First and last pixel of the union of the wavelengths' windows along an axis; last < first if empty."""
        first = first_pixel(centre[0], sigma[0])
        last = last_pixel(centre[0], sigma[0], size)
        if wp.static(width > 1):
            if first > last:
                first = size
                last = wp.int32(-1)
            for k in range(1, wp.static(width)):
                begin = first_pixel(centre[k], sigma[k])
                end = last_pixel(centre[k], sigma[k], size)
                if begin <= end:
                    first = wp.min(first, begin)
                    last = wp.max(last, end)
        return first, last

    @no_type_check
    @wp.func
    def cumulatives(edge: dtype, centre: vector, inv: vector):
        """Distribution functions [width] at an edge between pixels."""
        values = vector()
        for k in range(wp.static(width)):
            values[k] = cumulative((edge - centre[k]) * inv[k])
        return values

    @no_type_check
    @wp.func
    def row_window(f: Footprints, image: wp.array4d[sums]):
        """First and last row that the footprints touch."""
        size = image.shape[2]
        if wp.static(is_packed):
            size = image.shape[1]
        first, last = window(f.row, f.sigma_y, size)
        return first, last

    @no_type_check
    @wp.func
    def add_rows(
        f: Footprints,
        first_row: wp.int32,
        last_row: wp.int32,
        b: wp.int32,
        channel: wp.int32,
        lane: wp.int32,
        image: wp.array4d[sums],
    ):
        """Add some rows of the footprints to image b; a single wavelength goes to its channel."""
        size = image.shape[3]
        if wp.static(is_packed):
            size = image.shape[2]
        inv_x = wp.cw_div(vector(one), f.sigma_x)
        inv_y = wp.cw_div(vector(one), f.sigma_y)
        first_own = first_row
        last_own = last_row
        if wp.static(row_lanes > 1):
            run_of_rows = (last_row - first_row + wp.static(row_lanes)) // wp.static(row_lanes)
            first_own = first_row + lane // wp.static(column_lanes) * run_of_rows
            last_own = wp.min(last_row, first_own + run_of_rows - 1)
        below = cumulatives(dtype(first_own), f.row, inv_y)
        for i in range(first_own, last_own + 1):
            # --- the row's share of the light [width], and where its profile lies
            above = cumulatives(dtype(i + 1), f.row, inv_y)
            share = wp.cw_mul(f.amplitude, above - below)
            below = above
            centre = f.column + wp.cw_mul(f.beta, vector(dtype(i) + half) - f.row)
            first, last = window(centre, f.sigma_x, size)
            # --- its columns
            if wp.static(in_registers):
                add_row(image, b, channel, i, first, last, centre[0], inv_x[0], share[0])
            else:
                left = vector()
                if wp.static(column_lanes == 1):
                    left = cumulatives(dtype(first), centre, inv_x)
                for j in range(first + lane % wp.static(column_lanes), last + 1, wp.static(column_lanes)):
                    if wp.static(column_lanes > 1):
                        left = cumulatives(dtype(j), centre, inv_x)
                    right = cumulatives(dtype(j + 1), centre, inv_x)
                    light = wp.cw_mul(share, right - left)
                    left = right
                    if wp.static(width > 1):
                        add_pixel(image, b, i, j, light)
                    elif wp.static(is_packed):
                        wp.atomic_add(image, b, i, j, channel, counted(light[0]))
                    else:
                        wp.atomic_add(image, b, channel, i, j, counted(light[0]))

    return SimpleNamespace(row_window=row_window, add_rows=add_rows)


def _adding_gaussians(dtype: Any) -> SimpleNamespace:
    """The same for a Gaussian in registers, which finds its rows itself: ``row_window`` is any that is not empty."""
    add_gaussian, _ = gaussian_functions(dtype)
    Footprints = footprint_struct(dtype, 1)

    @no_type_check
    @wp.func
    def row_window(f: Footprints, image: wp.array4d[dtype]):
        return wp.int32(0), image.shape[2] - 1

    @no_type_check
    @wp.func
    def add_rows(
        f: Footprints,
        first_row: wp.int32,
        last_row: wp.int32,
        b: wp.int32,
        channel: wp.int32,
        lane: wp.int32,
        image: wp.array4d[dtype],
    ):
        add_gaussian(image, b, channel, f.column[0], f.row[0], f.sigma_x[0], f.sigma_y[0], f.beta[0], f.amplitude[0])

    return SimpleNamespace(row_window=row_window, add_rows=add_rows)


@made_once
def gathering_function(dtype: Any, profile: str, lanes: int, in_registers: bool) -> Any:
    """``gather``: adjoint of ``add_rows`` for one wavelength and planar images; arguments as above."""
    if in_registers and profile == "gaussian":
        return _gathering_gaussians(dtype)
    cumulative, density = profile_functions(dtype, profile, is_brief=dtype is wp.float32)
    first_pixel, last_pixel = window_functions(dtype, profile)
    _, gather_row = cpu_row_functions(dtype)
    Footprint = footprint_struct(dtype, 0)
    zero = wp.constant(dtype(0.0))
    half = wp.constant(dtype(0.5))
    one = wp.constant(dtype(1.0))
    row_lanes, column_lanes = lanes_apart(lanes)

    @no_type_check
    @wp.func
    def gather(f: Footprint, b: wp.int32, c: wp.int32, lane: wp.int32, grad_image: wp.array4d[dtype]):
        """Gradient with respect to a footprint of unit amplitude: moments of the image gradient under it."""
        inv_x = one / f.sigma_x
        inv_y = one / f.sigma_y
        g_column = zero
        g_row = zero
        g_sigma_x = zero
        g_sigma_y = zero
        g_beta = zero
        g_amplitude = zero
        first_row = first_pixel(f.row, f.sigma_y)
        last_row = last_pixel(f.row, f.sigma_y, grad_image.shape[2])
        if wp.static(row_lanes > 1):
            run_of_rows = (last_row - first_row + wp.static(row_lanes)) // wp.static(row_lanes)
            first_row += lane // wp.static(column_lanes) * run_of_rows
            last_row = wp.min(last_row, first_row + run_of_rows - 1)
        t_below = (dtype(first_row) - f.row) * inv_y
        below = cumulative(t_below)
        below_density = density(t_below)
        for i in range(first_row, last_row + 1):
            t_above = (dtype(i + 1) - f.row) * inv_y
            above = cumulative(t_above)
            above_density = density(t_above)
            offset = dtype(i) + half - f.row
            centre = f.column + f.beta * offset
            # --- sums over the row of G times: the share, its derivative by centre and by width
            row_sum = zero
            row_slope = zero
            row_width = zero
            first_column = first_pixel(centre, f.sigma_x)
            last_column = last_pixel(centre, f.sigma_x, grad_image.shape[3])
            if wp.static(in_registers):
                sums = gather_row(grad_image, b, c, i, first_column, last_column, centre, inv_x)
                row_sum = sums[0]
                row_slope = sums[1]
                row_width = sums[2]
            else:
                if wp.static(column_lanes > 1):
                    # Each lane takes a run of neighbouring columns, so that edges are evaluated once.
                    run = (last_column - first_column + wp.static(column_lanes)) // wp.static(column_lanes)
                    first_column += lane % wp.static(column_lanes) * run
                    last_column = wp.min(last_column, first_column + run - 1)
                t_left = (dtype(first_column) - centre) * inv_x
                left = cumulative(t_left)
                left_density = density(t_left)
                for j in range(first_column, last_column + 1):
                    t_right = (dtype(j + 1) - centre) * inv_x
                    right = cumulative(t_right)
                    right_density = density(t_right)
                    g = grad_image[b, c, i, j]
                    row_sum += g * (right - left)
                    row_slope += g * (right_density - left_density)
                    row_width += g * (t_right * right_density - t_left * left_density)
                    t_left = t_right
                    left = right
                    left_density = right_density
            # --- the row's part of each derivative
            share = above - below
            g_centre = -share * row_slope * inv_x
            g_amplitude += share * row_sum
            g_sigma_x -= share * row_width * inv_x
            g_column += g_centre
            g_beta += g_centre * offset
            g_row -= (above_density - below_density) * inv_y * row_sum + f.beta * g_centre
            g_sigma_y -= (t_above * above_density - t_below * below_density) * inv_y * row_sum
            t_below = t_above
            below = above
            below_density = above_density
        return Footprint(g_column, g_row, g_sigma_x, g_sigma_y, g_beta, g_amplitude)

    return gather


def _gathering_gaussians(dtype: Any) -> Any:
    """The same for a Gaussian in registers."""
    _, gather_gaussian = gaussian_functions(dtype)
    Footprint = footprint_struct(dtype, 0)

    @no_type_check
    @wp.func
    def gather(f: Footprint, b: wp.int32, c: wp.int32, lane: wp.int32, grad_image: wp.array4d[dtype]):
        g = gather_gaussian(grad_image, b, c, f.column, f.row, f.sigma_x, f.sigma_y, f.beta)
        return Footprint(g[0], g[1], g[2], g[3], g[4], g[5])

    return gather
