"""Kernels of lines that vary along their way: thicker and thinner, and aside of the straight line that was meant.

Both are told at knots, evenly spaced from a line's start to its end, and are straight between them.
"""

from typing import no_type_check

import warp as wp

from warp_caustics.prints.end_kernels import thick_part
from warp_caustics.prints.kernels import across, cell_point, segment_gap, steep_edge


@wp.struct
class WavySection:
    """What all lines have in common: see :class:`~warp_caustics.prints.line_shape.Shape`; its kernels take the same."""

    exponent: wp.float32
    parabola: wp.float32
    edge: wp.float32
    is_cap: wp.bool
    thicker: wp.float32
    end: wp.float32
    thickest: wp.float32
    """Times the width of a line it has at most, with its ends and its waves."""
    aside: wp.float32
    """Farthest it lies aside [m]."""


@wp.struct
class WavyPoint:
    """A point beside a line."""

    told: wp.vec4
    """Height [m], and its derivatives by distance, width and height [1]."""
    gap: wp.vec2
    """From the middle of the line [m]."""
    share: wp.float32
    """Of the line's length, where its nearest part is."""
    knot: wp.int32
    part: wp.float32
    """The knot before that part, and how far it is on the way to the next one [1]."""
    end: wp.float32
    """Factor of the thicker end."""
    slope: wp.float32
    """Change of the thickness by the share."""
    sideways: wp.float32
    """Change of the way aside by the share [m]."""
    is_free: wp.bool
    """Whether that part is another one when an end moves."""


@no_type_check
@wp.func
def wavy_point(
    lines: wp.array2d[wp.float32],
    knots: wp.array3d[wp.float32],
    counts: wp.array[wp.int32],
    k: wp.int32,
    offset: wp.vec2,
    along: wp.vec2,
    length: wp.float32,
    section: WavySection,
    side: wp.float32,
) -> WavyPoint:
    """At an offset from the line's start [m]; a point of a print stands for a square of a ``side`` [m]."""
    found = WavyPoint()
    nearest = segment_gap(offset, along, 1.0 / (length * length))
    found.share = nearest[2]
    found.end = wp.float32(1.0)
    falls = wp.float32(0.0)
    found.is_free = nearest[2] > 0.0 and nearest[2] < 1.0
    if section.thicker > 0.0:
        # Waves are far longer than what an end swells over: the part that is the highest without them is so with them.
        part = thick_part(
            offset,
            along,
            length,
            lines[k, 4],
            lines[k, 5],
            section.exponent,
            section.parabola,
            section.edge,
            section.is_cap,
            wp.vec2(section.thicker, section.end),
            side,
            steep_edge(section.exponent, section.parabola, section.edge),
        )
        found.share = part.share
        found.end = part.thickness
        found.is_free = part.is_free
        falls = part.slope
    pieces = wp.float32(counts[k] - 1)
    place = found.share * pieces
    found.knot = wp.min(wp.int32(place), counts[k] - 2)
    found.part = place - wp.float32(found.knot)
    more = knots[k, found.knot + 1, 0] - knots[k, found.knot, 0]
    farther = knots[k, found.knot + 1, 1] - knots[k, found.knot, 1]
    wave = 1.0 + knots[k, found.knot, 0] + found.part * more
    found.slope = found.end * more * pieces + falls * wave
    found.sideways = farther * pieces
    aside = (knots[k, found.knot, 1] + found.part * farther) / length
    straight = offset - found.share * along
    found.gap = wp.vec2(straight[0] + aside * along[1], straight[1] - aside * along[0])
    thickness = found.end * wave
    found.told = across(
        section.exponent,
        section.parabola,
        section.edge,
        section.is_cap,
        wp.length(found.gap),
        thickness * lines[k, 4],
        thickness * lines[k, 5],
        side,
        steep_edge(section.exponent, section.parabola, section.edge),
    )
    return found


@no_type_check
@wp.func
def is_far(centre: wp.vec2, along: wp.vec2, length: wp.float32, width: wp.float32, section: WavySection, cell: wp.vec2):
    """Whether no point of a cell is on a line, from the offset of its centre from the line's start [m]."""
    nearest = segment_gap(centre, along, 1.0 / (length * length))
    reach = 0.5 * (section.edge * section.thickest * width + cell[0] + cell[1]) + section.aside
    return nearest[0] * nearest[0] + nearest[1] * nearest[1] > reach * reach


@no_type_check
@wp.kernel(enable_backward=False)
def wavy_heights(
    lines: wp.array2d[wp.float32],
    knots: wp.array3d[wp.float32],
    counts: wp.array[wp.int32],
    section: WavySection,
    cell: wp.vec2,
    samples: wp.int32,
    supersampling: wp.int32,
    # outputs
    heights: wp.array4d[wp.float32],
):
    """Heights [L, n, n, 1] [m] of single lines [L, 6] (LINE_COLUMNS) [m] with knots [L, K, 2] ([1], [m]).

    Means of cells; at their points where ``heights`` are as many.
    """
    k, i, j = wp.tid()
    count = supersampling * supersampling
    is_mean = heights.shape[3] < count
    if not is_mean:
        for sub in range(count):
            heights[k, i, j, sub] = 0.0
    start = wp.vec2(lines[k, 0], lines[k, 1])
    along = wp.vec2(lines[k, 2], lines[k, 3]) - start
    length = wp.max(wp.length(along), 1.0e-10)
    total = wp.float32(0.0)
    centre = cell_point(i, j, -1, supersampling, cell, samples) - start
    if not is_far(centre, along, length, lines[k, 4], section, cell):
        side = 0.5 * (cell[0] + cell[1]) / wp.float32(supersampling)
        for sub in range(count):
            offset = cell_point(i, j, sub, supersampling, cell, samples) - start
            height = wavy_point(lines, knots, counts, k, offset, along, length, section, side).told[0]
            total += height
            if not is_mean:
                heights[k, i, j, sub] = height
    if is_mean:
        heights[k, i, j, 0] = total / wp.float32(count)


@no_type_check
@wp.kernel(enable_backward=False)
def wavy_heights_adjoint(
    lines: wp.array2d[wp.float32],
    knots: wp.array3d[wp.float32],
    counts: wp.array[wp.int32],
    section: WavySection,
    cell: wp.vec2,
    samples: wp.int32,
    supersampling: wp.int32,
    grad_heights: wp.array4d[wp.float32],
    # outputs
    grad_lines: wp.array2d[wp.float32],
    grad_knots: wp.array3d[wp.float32],
):
    """Adds to the gradients by lines [L, 6] and knots [L, K, 2] from that by heights as of :func:`wavy_heights`."""
    k, i, j = wp.tid()
    count = supersampling * supersampling
    is_mean = grad_heights.shape[3] < count
    start = wp.vec2(lines[k, 0], lines[k, 1])
    along = wp.vec2(lines[k, 2], lines[k, 3]) - start
    length = wp.max(wp.length(along), 1.0e-10)
    centre = cell_point(i, j, -1, supersampling, cell, samples) - start
    if not is_far(centre, along, length, lines[k, 4], section, cell):
        side = 0.5 * (cell[0] + cell[1]) / wp.float32(supersampling)
        grad = grad_heights[k, i, j, 0] / wp.float32(count)
        for sub in range(count):
            if not is_mean:
                grad = grad_heights[k, i, j, sub]
            offset = cell_point(i, j, sub, supersampling, cell, samples) - start
            at = wavy_point(lines, knots, counts, k, offset, along, length, section, side)
            # Sections that are steep at their edge have a slope a little beyond it.
            if at.told[0] > 0.0 or at.told[1] != 0.0:
                wave = 1.0 + (1.0 - at.part) * knots[k, at.knot, 0] + at.part * knots[k, at.knot + 1, 0]
                thickness = at.end * wave
                outward = grad * at.told[1] / wp.max(wp.length(at.gap), 1.0e-15) * at.gap
                by_thickness = grad * (lines[k, 4] * at.told[2] + lines[k, 5] * at.told[3])
                by_aside = (outward[0] * along[1] - outward[1] * along[0]) / length
                wp.atomic_add(grad_lines, k, 4, grad * thickness * at.told[2])
                wp.atomic_add(grad_lines, k, 5, grad * thickness * at.told[3])
                by_start = -(1.0 - at.share) * outward
                by_end = -at.share * outward
                if at.is_free:
                    # The nearest part is another one when an end moves.
                    by_share = (by_thickness * at.slope + by_aside * at.sideways) / (length * length)
                    across_m = offset - at.share * along
                    by_start += by_share * (-(1.0 - at.share) * along - across_m)
                    by_end += by_share * (across_m - at.share * along)
                wp.atomic_add(grad_lines, k, 0, by_start[0])
                wp.atomic_add(grad_lines, k, 1, by_start[1])
                wp.atomic_add(grad_lines, k, 2, by_end[0])
                wp.atomic_add(grad_lines, k, 3, by_end[1])
                wp.atomic_add(grad_knots, k, at.knot, 0, (1.0 - at.part) * at.end * by_thickness)
                wp.atomic_add(grad_knots, k, at.knot + 1, 0, at.part * at.end * by_thickness)
                wp.atomic_add(grad_knots, k, at.knot, 1, (1.0 - at.part) * by_aside)
                wp.atomic_add(grad_knots, k, at.knot + 1, 1, at.part * by_aside)
