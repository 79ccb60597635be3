"""What a line is, for all kernels that print: points of a cell, distance to a segment, cross section; and one of them.

That prints strokes of a data set. Lines with their derivatives are in :mod:`warp_caustics.prints.line_kernels`.
"""

from typing import Any, no_type_check

import warp as wp

from warp_caustics.kernels.made_once import made_once

PI = wp.constant(3.14159265358979)


@no_type_check
@wp.func
def section_height(
    family: wp.float32, exponent: wp.float32, reach: wp.float32, distance: wp.float32, width: wp.float32
):
    """Height relative to the crown inside a line [1], line.section_height in float32; family: its number."""
    if family < 0.5:
        angle = PI * distance / width
        # Both sections that need no power, as data sets had them before sections varied.
        if exponent == 1.0:
            return 0.5 * (1.0 + wp.cos(2.0 * angle))
        if exponent == 0.5:
            return wp.cos(angle)
        return wp.pow(wp.max(wp.cos(angle), 0.0), 2.0 * exponent)
    t = 2.0 * distance / width
    if family < 1.5:
        return wp.pow(wp.max(1.0 - t * t, 0.0), exponent)
    k = 2.772588722239781 * exponent
    edge = wp.exp(-k * reach * reach)
    return (wp.exp(-k * t * t) - edge) / (1.0 - edge)


@no_type_check
@wp.func
def line_section(exponent: wp.float32, parabola: wp.float32, t: wp.float32):
    """Height of a line relative to its crown, and its derivative by t = 2 r / w [1]; as in line_shape.py, in float32.

    ((1 - p) cos(pi t / 2)^2 + p (1 - t^2))^g: cosines where the share p of the parabola is 0, parabolas where it is 1.
    """
    angle = 0.5 * PI * t
    if parabola == 0.0:
        if exponent == 1.0:
            return wp.vec2(0.5 * (1.0 + wp.cos(2.0 * angle)), -0.5 * PI * wp.sin(2.0 * angle))
        if exponent == 0.5:
            return wp.vec2(wp.cos(angle), -0.5 * PI * wp.sin(angle))
    cosine = wp.cos(angle)
    # From the edge on a power below 1 has no slope; a sample's mean hardly sees the last thousandth of the width.
    base = wp.max((1.0 - parabola) * cosine * cosine + parabola * (1.0 - t * t), 1.0e-6)
    slope = -(1.0 - parabola) * PI * wp.sin(angle) * cosine - 2.0 * parabola * t
    height = wp.pow(base, exponent)
    return wp.vec2(height, exponent * height / base * slope)


@no_type_check
@wp.func
def mean_slope(exponent: wp.float32, parabola: wp.float32, t: wp.float32, step: wp.float32):
    """Derivative by t of the section's mean over ``step`` around t [1], of sections that are steep at their edge.

    Where a power below 1 begins its slope has no bound, and a few points of a print, those nearest to an edge, would
    outweigh all others in a fit; the mean over what a point stands for has one.
    """
    inner = wp.abs(t - 0.5 * step)
    outer = t + 0.5 * step
    height = wp.float32(0.0)
    if inner < 1.0:
        height = line_section(exponent, parabola, inner)[0]
    if outer < 1.0:
        height -= line_section(exponent, parabola, outer)[0]
    return -height / step


@no_type_check
@wp.func
def cap_height(distance: wp.float32, width: wp.float32, height: wp.float32):
    """Height of a circular cap [m] at a distance from its middle, and derivatives by distance, width and height [1].

    The circle through both feet and the crown, of radius R = (w^2 / 4 + H^2) / (2 H). A cap that is higher than half
    its width overhangs its foot and is no height field: it is taken for the half circle, drawn out.
    """
    half = 0.5 * width
    crown = wp.min(height, half)
    drawn = height / crown
    radius = (half * half + crown * crown) / (2.0 * crown)
    # A standing edge has no slope; a sample's mean hardly sees the last thousandth of the width.
    root = wp.sqrt(wp.max(radius * radius - distance * distance, 1.0e-6 * radius * radius))
    by_radius = radius / root - 1.0
    by_half = by_radius * half / crown
    by_crown = 1.0 + by_radius * 0.5 * (1.0 - half * half / (crown * crown))
    # R - sqrt(R^2 - r^2) without a difference of nearly equal numbers: of a flat cap that would be below 0 at its edge.
    above = wp.max(crown - distance * distance / (radius + root), 0.0)
    if drawn > 1.0:
        by_half += by_crown - above / crown
        by_crown = above / crown
    return wp.vec4(drawn * above, -drawn * distance / root, 0.5 * drawn * by_half, by_crown)


@no_type_check
@wp.func
def cell_point(i: wp.int32, j: wp.int32, sub: wp.int32, across: wp.int32, pitch: wp.vec2, samples: wp.int32):
    """Place of point ``sub`` of the across^2 points in cell (i, j) of a plate [m]; of the cell's centre if it is -1."""
    corner_x = (wp.float32(j) - 0.5 * wp.float32(samples)) * pitch[0]
    corner_y = (wp.float32(i) - 0.5 * wp.float32(samples)) * pitch[1]
    if sub < 0:
        return wp.vec2(corner_x + 0.5 * pitch[0], corner_y + 0.5 * pitch[1])
    step_x = pitch[0] / wp.float32(across)
    step_y = pitch[1] / wp.float32(across)
    return wp.vec2(
        corner_x + (wp.float32(sub % across) + 0.5) * step_x, corner_y + (wp.float32(sub // across) + 0.5) * step_y
    )


@no_type_check
@wp.func
def segment_gap(offset: wp.vec2, along: wp.vec2, inverse: wp.float32):
    """From the nearest point of a segment to a point: (x, y) [m], and where that is, from 0 at the start to 1.

    Takes the point's offset from the start [m], end - start [m], and 1 / |end - start|^2 [1/m^2].
    """
    nearest = wp.clamp(wp.dot(offset, along) * inverse, 0.0, 1.0)
    return wp.vec3(offset[0] - nearest * along[0], offset[1] - nearest * along[1], nearest)


@no_type_check
@wp.func
def printed_over(height: wp.float32, other: wp.float32, power: wp.float32):
    """(h^p + o^p)^(1/p) of two heights >= 0 [m]; p = 1 adds them up, p < 0 takes the higher one.

    Relative to the higher one: powers of heights leave single precision, in which 0.05 mm to the power of 30 is
    nothing. Lines of p = 28 had edges 5 um high then, of p = 48 55 um, and no line near a caustic could move by 0.1 um
    without a jump of its image.
    """
    higher = wp.max(height, other)
    lower = wp.min(height, other)
    if lower <= 0.0 or power < 0.0:
        return higher
    if power == 1.0:
        return higher + lower
    return higher * wp.pow(1.0 + wp.pow(lower / higher, power), 1.0 / power)


@made_once
def stroke_kernel(supersampling: int, can_merge: bool) -> Any:
    """Kernel ``print_strokes``; reliefs whose lines merge need ``can_merge``, and supersampling^2 sums per thread."""
    points = supersampling * supersampling
    sums_type = wp.types.vector(length=points if can_merge else 1, dtype=wp.float32)

    @no_type_check
    @wp.kernel(enable_backward=False, module="unique")
    def print_strokes(
        strokes: wp.array3d[wp.float32],
        traits: wp.array2d[wp.float32],
        pitch_x: wp.float32,
        pitch_y: wp.float32,
        samples: wp.int32,
        # outputs
        heights: wp.array3d[wp.float32],
    ):
        """Heights [B, n, n] [m] of strokes [B, L, 7] (STROKE_COLUMNS) and traits [B, 7] (TRAIT_COLUMNS)."""
        b, i, j = wp.tid()
        pitch = wp.vec2(pitch_x, pitch_y)
        family = traits[b, 0]
        exponent = traits[b, 1]
        ends = traits[b, 2]
        merging = traits[b, 3]
        total = wp.float32(0.0)
        sums = sums_type()
        for k in range(strokes.shape[1]):
            height = strokes[b, k, 6]
            if height > 0.0:
                ring = strokes[b, k, 0] > 0.5
                start = wp.vec2(strokes[b, k, 1], strokes[b, k, 2])
                along = wp.vec2(strokes[b, k, 3], strokes[b, k, 4]) - start
                radius = strokes[b, k, 3]
                inverse = 1.0 / wp.max(wp.dot(along, along), 1.0e-20)
                width = strokes[b, k, 5]
                reach = 0.5 * (ends * width + pitch_x + pitch_y)
                for sub in range(-1, wp.static(points)):
                    # The first round is the cell's centre: most strokes pass far from it.
                    offset = cell_point(i, j, sub, wp.static(supersampling), pitch, samples) - start
                    distance = wp.float32(0.0)
                    if ring:
                        distance = wp.abs(wp.length(offset) - radius)
                    else:
                        gap = segment_gap(offset, along, inverse)
                        distance = wp.sqrt(gap[0] * gap[0] + gap[1] * gap[1])
                    if sub < 0:
                        if distance > reach:
                            break
                    elif distance < 0.5 * ends * width:
                        added = height * section_height(family, exponent, ends, distance, width)
                        if wp.static(can_merge):
                            if merging > 1.0:
                                # In millimetres, so that powers stay within float32.
                                sums[sub] = sums[sub] + wp.pow(1000.0 * added, merging)
                            else:
                                total += added
                        else:
                            total += added
        if wp.static(can_merge) and merging > 1.0:
            for sub in range(wp.static(points)):
                total += 0.001 * wp.pow(sums[sub], 1.0 / merging)
        centre = cell_point(i, j, -1, wp.static(supersampling), pitch, samples)
        x = centre[0]
        y = centre[1]
        bow = traits[b, 4] * x * x + traits[b, 5] * x * y + traits[b, 6] * y * y
        heights[b, i, j] = total / wp.float32(wp.static(points)) + bow

    return print_strokes


@no_type_check
@wp.func
def across(
    exponent: wp.float32,
    parabola: wp.float32,
    edge: wp.float32,
    is_cap: wp.bool,
    distance: wp.float32,
    width: wp.float32,
    height: wp.float32,
    step: wp.float32,
    is_steep: wp.bool,
):
    """Height of a line [m] at a distance from its middle, and its derivatives by distance, width and height [1].

    Of sections that are steep at their edge the slope is the mean over a ``step`` [m].
    """
    inside = distance < 0.5 * edge * width
    if is_cap:
        if inside:
            return cap_height(distance, width, height)
        return wp.vec4(0.0, 0.0, 0.0, 0.0)
    t = 2.0 * distance / width
    section = wp.vec2(0.0, 0.0)
    if inside:
        section = line_section(exponent, parabola, t)
        if edge < 1.0:
            # What is cut off: nothing that shows where a section has only faded. Never below the plate: on a GPU powers
            # fall by steps, and a height of -1e-12 m has no power.
            cut = line_section(exponent, parabola, edge)[0]
            section = wp.vec2(wp.max(section[0] - cut, 0.0), section[1]) / (1.0 - cut)
    slope = section[1]
    if is_steep:
        slope = mean_slope(exponent, parabola, t, 2.0 * step / width)
    return wp.vec4(height * section[0], height * slope * 2.0 / width, -height * slope * t / width, section[0])


@no_type_check
@wp.func
def steep_edge(exponent: wp.float32, parabola: wp.float32, edge: wp.float32):
    """Whether the slope of a section has no bound where it ends."""
    return edge == 1.0 and exponent < 1.0 and (parabola > 0.0 or exponent < 0.5)
