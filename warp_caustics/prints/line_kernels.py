"""Kernels of single lines with their derivatives: means of cells."""

from typing import no_type_check

import warp as wp

from warp_caustics.prints.end_kernels import thick_part
from warp_caustics.prints.kernels import across, cell_point, segment_gap, steep_edge

LineCell = wp.types.vector(length=7, dtype=wp.float32)
"""Height of one line in a cell, or at a point of it [m], and its derivatives by the line's six numbers [1]."""


@no_type_check
@wp.func
def is_near_cell(
    lines: wp.array2d[wp.float32],
    k: wp.int32,
    i: wp.int32,
    j: wp.int32,
    reach: wp.float32,
    pitch: wp.vec2,
    samples: wp.int32,
):
    """Whether a cell may have a part of line k, which has heights up to ``reach`` [m] aside of it."""
    start = wp.vec2(lines[k, 0], lines[k, 1])
    along = wp.vec2(lines[k, 2], lines[k, 3]) - start
    inverse = 1.0 / wp.max(wp.dot(along, along), 1.0e-20)
    nearest = segment_gap(cell_point(i, j, -1, 1, pitch, samples) - start, along, inverse)
    return wp.length(wp.vec2(nearest[0], nearest[1])) <= reach + 0.5 * (pitch[0] + pitch[1])


@no_type_check
@wp.func
def thick_point(
    lines: wp.array2d[wp.float32],
    k: wp.int32,
    point: wp.vec2,
    side: wp.float32,
    exponent: wp.float32,
    parabola: wp.float32,
    edge: wp.float32,
    is_cap: wp.bool,
    ends: wp.vec2,
    beyond: wp.float32,
) -> LineCell:
    """:func:`line_point` of lines with thicker ends; ``beyond`` their edge [m] a point may stand for a part of them."""
    start = wp.vec2(lines[k, 0], lines[k, 1])
    along = wp.vec2(lines[k, 2], lines[k, 3]) - start
    width, height = lines[k, 4], lines[k, 5]
    length = wp.max(wp.length(along), 1.0e-10)
    offset = point - start
    part = thick_part(offset, along, length, width, height, exponent, parabola, edge, is_cap, ends, side, beyond > 0.0)
    gap = offset - part.share * along
    told = across(
        exponent,
        parabola,
        edge,
        is_cap,
        wp.length(gap),
        part.thickness * width,
        part.thickness * height,
        side,
        beyond > 0.0,
    )
    outward = told[1] / wp.max(wp.length(gap), 1.0e-15) * gap
    ahead = along / length
    is_start = part.share < 0.5
    share = part.share
    if not is_start:
        share = 1.0 - share
    # That part moves with its end, and turns about it with the other one.
    turned = share * (outward - wp.dot(outward, ahead) * ahead)
    by_near = turned - outward
    by_far = -turned
    if part.is_free:
        # The nearest part of a piece is another one when an end moves.
        by_way = part.slope / length * (width * told[2] + height * told[3])
        aside = by_way / length * (gap - wp.dot(gap, ahead) * ahead)
        if is_start:
            by_near -= by_way * ahead + aside
            by_far += aside
        else:
            by_near -= by_way * ahead - aside
            by_far -= aside
    found = LineCell()
    found[0] = told[0]
    if not is_start:
        by_near, by_far = by_far, by_near
    found[1] = by_near[0]
    found[2] = by_near[1]
    found[3] = by_far[0]
    found[4] = by_far[1]
    found[5] = part.thickness * told[2]
    found[6] = part.thickness * told[3]
    return found


@no_type_check
@wp.func
def line_point(
    lines: wp.array2d[wp.float32],
    k: wp.int32,
    point: wp.vec2,
    side: wp.float32,
    exponent: wp.float32,
    parabola: wp.float32,
    edge: wp.float32,
    is_cap: wp.bool,
    ends: wp.vec2,
) -> LineCell:
    """``LineCell`` of line k at a point that stands for ``side`` along [m]; from ``edge`` half widths on it is 0.

    ``ends`` are the share by which it is wider and higher where it begins and ends [1], and how far that reaches [m]:
    share exp(-(s / reach)^2) at a way s from there, see :func:`thick_point`.
    """
    start = wp.vec2(lines[k, 0], lines[k, 1])
    along = wp.vec2(lines[k, 2], lines[k, 3]) - start
    inverse = 1.0 / wp.max(wp.dot(along, along), 1.0e-20)
    width = lines[k, 4]
    height = lines[k, 5]
    found = LineCell()
    # How far beyond the edge the point may lie to stand for a part of the line.
    is_steep = steep_edge(exponent, parabola, edge)
    beyond = wp.float32(0.0)
    if is_steep:
        beyond = 0.5 * side
    nearest = segment_gap(point - start, along, inverse)
    gap = wp.vec2(nearest[0], nearest[1])
    distance = wp.length(gap)
    if distance >= 0.5 * edge * (1.0 + ends[0]) * width + beyond:
        return found
    if ends[0] > 0.0:
        return thick_point(lines, k, point, side, exponent, parabola, edge, is_cap, ends, beyond)
    told = across(exponent, parabola, edge, is_cap, distance, width, height, side, is_steep)
    # Moving the nearest point along the line changes r in second order only.
    outward = told[1] / wp.max(distance, 1.0e-15) * gap
    found[0] = told[0]
    found[1] = -(1.0 - nearest[2]) * outward[0]
    found[2] = -(1.0 - nearest[2]) * outward[1]
    found[3] = -nearest[2] * outward[0]
    found[4] = -nearest[2] * outward[1]
    found[5] = told[2]
    found[6] = told[3]
    return found


@no_type_check
@wp.func
def line_cell(
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
) -> LineCell:
    """``LineCell`` of line k in row i and column j; arguments as for :func:`line_point`."""
    found = LineCell()
    side = 0.5 * (pitch[0] + pitch[1]) / wp.float32(supersampling)
    # Most cells are far from the line.
    if is_near_cell(lines, k, i, j, 0.5 * edge * (1.0 + ends[0]) * lines[k, 4], pitch, samples):
        for sub in range(supersampling * supersampling):
            point = cell_point(i, j, sub, supersampling, pitch, samples)
            found += line_point(lines, k, point, side, exponent, parabola, edge, is_cap, ends)
    return found / wp.float32(supersampling * supersampling)


@no_type_check
@wp.func
def cells_of_row(
    lines: wp.array2d[wp.float32],
    k: wp.int32,
    i: wp.int32,
    reach: wp.float32,
    pitch: wp.vec2,
    samples: wp.int32,
):
    """First column of row i with a part of line k, and the one after the last; arguments as for :func:`is_near_cell`.

    On a CPU most of the time would go into far cells.
    """
    y = cell_point(i, 0, -1, 1, pitch, samples)[1]
    from_y = lines[k, 1] - y
    along_y = lines[k, 3] - lines[k, 1]
    farthest = reach + pitch[0] + pitch[1]
    first = wp.float32(0.0)
    last = wp.float32(1.0)
    if wp.abs(along_y) > 1.0e-9:
        # Where the centre line is within reach of the row.
        one = (-farthest - from_y) / along_y
        other = (farthest - from_y) / along_y
        first = wp.max(wp.min(one, other), 0.0)
        last = wp.min(wp.max(one, other), 1.0)
    elif wp.abs(from_y) > farthest:
        last = wp.float32(-1.0)
    low = wp.int32(0)
    high = wp.int32(0)
    if first <= last:
        along_x = lines[k, 2] - lines[k, 0]
        x0 = lines[k, 0] + first * along_x
        x1 = lines[k, 0] + last * along_x
        middle = 0.5 * wp.float32(samples)
        low = wp.max(wp.int32(wp.floor((wp.min(x0, x1) - farthest) / pitch[0] + middle)), 0)
        high = wp.min(wp.int32(wp.ceil((wp.max(x0, x1) + farthest) / pitch[0] + middle)), samples)
    return wp.vec2i(low, high)


@no_type_check
@wp.kernel(enable_backward=False)
def line_derivatives(
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
    # outputs
    heights: wp.array3d[wp.float32],
    derivatives: wp.array4d[wp.float32],
):
    """Heights [L, n, n] [m] of single lines [L, 6] (LINE_COLUMNS); derivatives [L, 6, n, n] [1] if there is room."""
    k, i, j = wp.tid()
    pitch, ends = wp.vec2(pitch_x, pitch_y), wp.vec2(thicker, end)
    found = line_cell(lines, k, i, j, exponent, parabola, edge, is_cap, ends, pitch, samples, supersampling)
    heights[k, i, j] = found[0]
    if k < derivatives.shape[0]:
        for number in range(6):
            derivatives[k, number, i, j] = found[number + 1]


@no_type_check
@wp.kernel(enable_backward=False)
def line_derivatives_by_row(
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
    # outputs
    heights: wp.array3d[wp.float32],
    derivatives: wp.array4d[wp.float32],
):
    """The same into arrays of zeros, a row of cells per thread."""
    k, i = wp.tid()
    pitch, ends = wp.vec2(pitch_x, pitch_y), wp.vec2(thicker, end)
    columns = cells_of_row(lines, k, i, 0.5 * edge * (1.0 + thicker) * lines[k, 4], pitch, samples)
    for j in range(columns[0], columns[1]):
        found = line_cell(lines, k, i, j, exponent, parabola, edge, is_cap, ends, pitch, samples, supersampling)
        heights[k, i, j] = found[0]
        if k < derivatives.shape[0]:
            for number in range(6):
                derivatives[k, number, i, j] = found[number + 1]
