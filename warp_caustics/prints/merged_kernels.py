"""Kernels of lines that do not add up where they cross (:mod:`warp_caustics.prints.overlap`), point by point of a cell.

Where two lines cross steeply the higher one changes within a cell: the mean of what is printed is not what would be
printed of the means. On a plate of ten lines of Tab. 3 of which the highest is printed both differ by 0.12 mm at most,
3 um in the mean, and in the caustic by a tenth of flat light.
"""

from typing import no_type_check

import warp as wp

from warp_caustics.prints.kernels import cell_point, printed_over
from warp_caustics.prints.line_kernels import LineCell, cells_of_row, is_near_cell, line_point

HIGHEST = -1.0
"""Power p of lines of which the highest is printed."""
ALIKE = wp.constant(1.0 - 1.0e-6)
"""Of what is printed, from which on a line is all of it, in single precision."""


@no_type_check
@wp.kernel(enable_backward=False)
def printed_points(
    lines: wp.array2d[wp.float32],
    exponent: wp.float32,
    parabola: wp.float32,
    edge: wp.float32,
    is_cap: wp.bool,
    thicker: wp.float32,
    end: wp.float32,
    pitch_x: wp.float32,
    pitch_y: wp.float32,
    samples: wp.int32,
    supersampling: wp.int32,
    power: wp.float32,
    # outputs
    points: wp.array3d[wp.float32],
):
    """Heights of lines [L, 6] over what is printed at the points of cells, [n, n, supersampling^2] [m]."""
    i, j = wp.tid()
    pitch, ends = wp.vec2(pitch_x, pitch_y), wp.vec2(thicker, end)
    side = 0.5 * (pitch[0] + pitch[1]) / wp.float32(supersampling)
    count = supersampling * supersampling
    for k in range(lines.shape[0]):
        if is_near_cell(lines, k, i, j, 0.5 * edge * (1.0 + thicker) * lines[k, 4], pitch, samples):
            for sub in range(count):
                point = cell_point(i, j, sub, supersampling, pitch, samples)
                height = line_point(lines, k, point, side, exponent, parabola, edge, is_cap, ends)[0]
                points[i, j, sub] = printed_over(points[i, j, sub], height, power)


@no_type_check
@wp.func
def merged_cell(
    lines: wp.array2d[wp.float32],
    k: wp.int32,
    i: wp.int32,
    j: wp.int32,
    exponent: wp.float32,
    parabola: wp.float32,
    edge: wp.float32,
    is_cap: wp.bool,
    ends: wp.vec2,
    pitch: wp.vec2,
    samples: wp.int32,
    supersampling: wp.int32,
    power: wp.float32,
    points: wp.array3d[wp.float32],
) -> LineCell:
    """``LineCell`` of line k, derivatives those of what is printed: dH/dh_i = (h_i / H)^(p - 1) at each point."""
    found = LineCell()
    side = 0.5 * (pitch[0] + pitch[1]) / wp.float32(supersampling)
    if is_near_cell(lines, k, i, j, 0.5 * edge * (1.0 + ends[0]) * lines[k, 4], pitch, samples):
        for sub in range(supersampling * supersampling):
            point = cell_point(i, j, sub, supersampling, pitch, samples)
            told = line_point(lines, k, point, side, exponent, parabola, edge, is_cap, ends)
            share = wp.float32(1.0)
            printed = points[i, j, sub]
            if told[0] < ALIKE * printed:
                share = wp.float32(0.0)
                if power > 0.0:
                    share = wp.pow(told[0] / printed, power - 1.0)
            found[0] += told[0]
            for number in range(1, 7):
                found[number] += share * told[number]
    return found / wp.float32(supersampling * supersampling)


@no_type_check
@wp.kernel(enable_backward=False)
def merged_derivatives(
    lines: wp.array2d[wp.float32],
    exponent: wp.float32,
    parabola: wp.float32,
    edge: wp.float32,
    is_cap: wp.bool,
    thicker: wp.float32,
    end: wp.float32,
    pitch_x: wp.float32,
    pitch_y: wp.float32,
    samples: wp.int32,
    supersampling: wp.int32,
    power: wp.float32,
    points: wp.array3d[wp.float32],
    # outputs
    derivatives: wp.array4d[wp.float32],
):
    """Derivatives [L, 6, n, n] [1] of what is printed, ``points`` of :func:`printed_points`, by lines [L, 6]."""
    k, i, j = wp.tid()
    pitch, ends = wp.vec2(pitch_x, pitch_y), wp.vec2(thicker, end)
    found = merged_cell(
        lines, k, i, j, exponent, parabola, edge, is_cap, ends, pitch, samples, supersampling, power, points
    )
    for number in range(6):
        derivatives[k, number, i, j] = found[number + 1]


@no_type_check
@wp.kernel(enable_backward=False)
def merged_derivatives_by_row(
    lines: wp.array2d[wp.float32],
    exponent: wp.float32,
    parabola: wp.float32,
    edge: wp.float32,
    is_cap: wp.bool,
    thicker: wp.float32,
    end: wp.float32,
    pitch_x: wp.float32,
    pitch_y: wp.float32,
    samples: wp.int32,
    supersampling: wp.int32,
    power: wp.float32,
    points: wp.array3d[wp.float32],
    # outputs
    derivatives: wp.array4d[wp.float32],
):
    """The same into zeros, a row of cells per thread."""
    k, i = wp.tid()
    pitch, ends = wp.vec2(pitch_x, pitch_y), wp.vec2(thicker, end)
    columns = cells_of_row(lines, k, i, 0.5 * edge * (1.0 + thicker) * lines[k, 4], pitch, samples)
    for j in range(columns[0], columns[1]):
        found = merged_cell(
            lines, k, i, j, exponent, parabola, edge, is_cap, ends, pitch, samples, supersampling, power, points
        )
        for number in range(6):
            derivatives[k, number, i, j] = found[number + 1]
