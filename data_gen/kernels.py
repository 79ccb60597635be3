"""Kernel that prints strokes: one thread per height sample, every stroke added up."""

from functools import cache
from typing import Any, no_type_check

import warp as wp


@cache
def stroke_kernel(is_quarter: bool) -> Any:
    """Kernel ``print_strokes``; the profile is ``quarter`` or else ``cosine``."""

    @no_type_check
    @wp.kernel(enable_backward=False, module="unique")
    def print_strokes(
        strokes: wp.array3d[wp.float32],
        pitch_x: wp.float32,
        pitch_y: wp.float32,
        samples: wp.int32,
        supersampling: wp.int32,
        # outputs
        heights: wp.array3d[wp.float32],
    ):
        """Heights [B, n, n] [m] of strokes [B, L, 7] (patterns.STROKE_COLUMNS), averaged over each cell."""
        b, i, j = wp.tid()
        step_x = pitch_x / wp.float32(supersampling)
        step_y = pitch_y / wp.float32(supersampling)
        corner_x = (wp.float32(j) - 0.5 * wp.float32(samples)) * pitch_x
        corner_y = (wp.float32(i) - 0.5 * wp.float32(samples)) * pitch_y
        total = wp.float32(0.0)
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
                reach = 0.5 * (width + pitch_x + pitch_y)
                for sub in range(-1, supersampling * supersampling):
                    # The first round is the cell's centre: most strokes pass far from it.
                    x = corner_x + 0.5 * pitch_x
                    y = corner_y + 0.5 * pitch_y
                    if sub >= 0:
                        x = corner_x + (wp.float32(sub % supersampling) + 0.5) * step_x
                        y = corner_y + (wp.float32(sub // supersampling) + 0.5) * step_y
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
                    elif distance < 0.5 * width:
                        angle = 3.14159265358979 * distance / width
                        if wp.static(is_quarter):
                            total += height * wp.cos(angle)
                        else:
                            total += 0.5 * height * (1.0 + wp.cos(2.0 * angle))
        heights[b, i, j] = total / wp.float32(supersampling * supersampling)

    return print_strokes
