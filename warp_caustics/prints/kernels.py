"""Kernel that prints strokes: one thread per height sample, every stroke added up."""

from functools import cache
from typing import Any, no_type_check

import warp as wp


@no_type_check
@wp.func
def section_height(
    section: wp.float32, exponent: wp.float32, reach: wp.float32, distance: wp.float32, width: wp.float32
):
    """Height relative to the crown inside a line, variety.section_height in float32."""
    if section < 0.5:
        angle = 3.14159265358979 * distance / width
        # Both profiles that need no power, as data sets had them before sections varied.
        if exponent == 1.0:
            return 0.5 * (1.0 + wp.cos(2.0 * angle))
        if exponent == 0.5:
            return wp.cos(angle)
        return wp.pow(wp.max(wp.cos(angle), 0.0), 2.0 * exponent)
    t = 2.0 * distance / width
    if section < 1.5:
        return wp.pow(wp.max(1.0 - t * t, 0.0), exponent)
    k = 2.772588722239781 * exponent
    edge = wp.exp(-k * reach * reach)
    return (wp.exp(-k * t * t) - edge) / (1.0 - edge)


@cache
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
        step_x = pitch_x / wp.float32(wp.static(supersampling))
        step_y = pitch_y / wp.float32(wp.static(supersampling))
        corner_x = (wp.float32(j) - 0.5 * wp.float32(samples)) * pitch_x
        corner_y = (wp.float32(i) - 0.5 * wp.float32(samples)) * pitch_y
        section = traits[b, 0]
        exponent = traits[b, 1]
        ends = traits[b, 2]
        merging = traits[b, 3]
        total = wp.float32(0.0)
        sums = sums_type()
        for k in range(strokes.shape[1]):
            height = strokes[b, k, 6]
            if height > 0.0:
                ring = strokes[b, k, 0] > 0.5
                x0 = strokes[b, k, 1]
                y0 = strokes[b, k, 2]
                x1 = strokes[b, k, 3]
                y1 = strokes[b, k, 4]
                width = strokes[b, k, 5]
                along_x = x1 - x0
                along_y = y1 - y0
                inverse = 1.0 / wp.max(along_x * along_x + along_y * along_y, 1.0e-20)
                reach = 0.5 * (ends * width + pitch_x + pitch_y)
                for sub in range(-1, wp.static(points)):
                    # The first round is the cell's centre: most strokes pass far from it.
                    x = corner_x + 0.5 * pitch_x
                    y = corner_y + 0.5 * pitch_y
                    if sub >= 0:
                        x = corner_x + (wp.float32(sub % wp.static(supersampling)) + 0.5) * step_x
                        y = corner_y + (wp.float32(sub // wp.static(supersampling)) + 0.5) * step_y
                    from_x = x - x0
                    from_y = y - y0
                    distance = wp.float32(0.0)
                    if ring:
                        distance = wp.abs(wp.sqrt(from_x * from_x + from_y * from_y) - x1)
                    else:
                        nearest = wp.clamp((from_x * along_x + from_y * along_y) * inverse, 0.0, 1.0)
                        gap_x = from_x - nearest * along_x
                        gap_y = from_y - nearest * along_y
                        distance = wp.sqrt(gap_x * gap_x + gap_y * gap_y)
                    if sub < 0:
                        if distance > reach:
                            break
                    elif distance < 0.5 * ends * width:
                        added = height * section_height(section, exponent, ends, distance, width)
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
        x = corner_x + 0.5 * pitch_x
        y = corner_y + 0.5 * pitch_y
        bow = traits[b, 4] * x * x + traits[b, 5] * x * y + traits[b, 6] * y * y
        heights[b, i, j] = total / wp.float32(wp.static(points)) + bow

    return print_strokes


@cache
def line_derivative_kernel(is_quarter: bool) -> Any:
    """Kernel ``line_derivatives``; the profile is ``quarter`` or else ``cosine``."""

    @no_type_check
    @wp.kernel(enable_backward=False, module="unique")
    def line_derivatives(
        lines: wp.array2d[wp.float32],
        pitch_x: wp.float32,
        pitch_y: wp.float32,
        samples: wp.int32,
        supersampling: wp.int32,
        # outputs
        heights: wp.array3d[wp.float32],
        derivatives: wp.array4d[wp.float32],
    ):
        """Heights [L, n, n] of single lines [L, 6] (x0, y0, x1, y1, width, height), and derivatives [L, 6, n, n]."""
        k, i, j = wp.tid()
        x0 = lines[k, 0]
        y0 = lines[k, 1]
        x1 = lines[k, 2]
        y1 = lines[k, 3]
        width = lines[k, 4]
        height = lines[k, 5]
        along_x = x1 - x0
        along_y = y1 - y0
        inverse = 1.0 / wp.max(along_x * along_x + along_y * along_y, 1.0e-20)
        step_x = pitch_x / wp.float32(supersampling)
        step_y = pitch_y / wp.float32(supersampling)
        corner_x = (wp.float32(j) - 0.5 * wp.float32(samples)) * pitch_x
        corner_y = (wp.float32(i) - 0.5 * wp.float32(samples)) * pitch_y
        total = wp.float32(0.0)
        by_x0 = wp.float32(0.0)
        by_y0 = wp.float32(0.0)
        by_x1 = wp.float32(0.0)
        by_y1 = wp.float32(0.0)
        by_width = wp.float32(0.0)
        by_height = wp.float32(0.0)
        for sub in range(-1, supersampling * supersampling):
            # The first round is the cell's centre: most cells are far from the line.
            x = corner_x + 0.5 * pitch_x
            y = corner_y + 0.5 * pitch_y
            if sub >= 0:
                x = corner_x + (wp.float32(sub % supersampling) + 0.5) * step_x
                y = corner_y + (wp.float32(sub // supersampling) + 0.5) * step_y
            from_x = x - x0
            from_y = y - y0
            nearest = wp.clamp((from_x * along_x + from_y * along_y) * inverse, 0.0, 1.0)
            gap_x = from_x - nearest * along_x
            gap_y = from_y - nearest * along_y
            distance = wp.sqrt(gap_x * gap_x + gap_y * gap_y)
            if sub < 0:
                if distance > 0.5 * (width + pitch_x + pitch_y):
                    break
            elif distance < 0.5 * width:
                angle = 3.14159265358979 * distance / width
                shape = wp.float32(0.0)
                slope = wp.float32(0.0)
                if wp.static(is_quarter):
                    shape = wp.cos(angle)
                    slope = -wp.sin(angle)
                else:
                    shape = 0.5 * (1.0 + wp.cos(2.0 * angle))
                    slope = -wp.sin(2.0 * angle)
                # d(shape)/d(angle) = slope; angle = pi r / w. Moving the nearest point along the line changes r in
                # second order only.
                by_distance = height * slope * 3.14159265358979 / width
                outward = by_distance / wp.max(distance, 1.0e-12)
                total += height * shape
                by_x0 -= outward * gap_x * (1.0 - nearest)
                by_y0 -= outward * gap_y * (1.0 - nearest)
                by_x1 -= outward * gap_x * nearest
                by_y1 -= outward * gap_y * nearest
                by_width -= by_distance * distance / width
                by_height += shape
        scale = 1.0 / wp.float32(supersampling * supersampling)
        heights[k, i, j] = total * scale
        derivatives[k, 0, i, j] = by_x0 * scale
        derivatives[k, 1, i, j] = by_y0 * scale
        derivatives[k, 2, i, j] = by_x1 * scale
        derivatives[k, 3, i, j] = by_y1 * scale
        derivatives[k, 4, i, j] = by_width * scale
        derivatives[k, 5, i, j] = by_height * scale

    return line_derivatives
