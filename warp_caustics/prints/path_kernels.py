"""Kernel that prints lines of any shape: rows of pieces that belong together, with caps, crossings and a wavy base.

A line is a row, and rows of kind ``JOINED`` that go on where the one before ended. Its height is the highest of its
rows: in a joint nothing is doubled. Rows stand in blocks of ``BLOCK``, each with the box outside of which it prints
nothing, so that a curve of hundreds of pieces costs a cell little more than the pieces near it. Plain straight lines
go through :func:`warp_caustics.prints.kernels.stroke_kernel`, which knows none of this.
"""

from typing import Any, no_type_check

import warp as wp

from warp_caustics.kernels.made_once import made_once
from warp_caustics.prints.kernels import cell_point, printed_over, section_height, segment_gap
from warp_caustics.prints.rows import BEGIN, JOINED, RING

BLOCK = 8
"""Rows of one box."""

BOX_COLUMNS = ("x_low_m", "y_low_m", "x_high_m", "y_high_m", "begins")
"""Of a block: what it can touch, and 1 if a line begins in it."""

PATH_TRAIT_COLUMNS = (
    "section",
    "parameter",
    "reach",
    "merging",
    "bow_xx",
    "bow_xy",
    "bow_yy",
    "wave_m",
    "wave_x",
    "wave_y",
    "wave_phase",
)
"""Of a relief: number of the section (``KINDS``), its parameter (``CrossSection.parameter``) and reach, p of lines on
top of each other (infinite: the highest), bow [1/m], and a wave a sin(k_x x + k_y y + phase) of the base."""


@no_type_check
@wp.func
def path_section_height(
    kind: wp.float32, parameter: wp.float32, reach: wp.float32, distance: wp.float32, width: wp.float32
):
    """Height relative to the crown inside a line [1], CrossSection.relative_height in float32."""
    if kind < 2.5:
        return section_height(kind, parameter, reach, distance, width)
    t = 2.0 * distance / width
    inside = wp.max(1.0 - t * t, 0.0)
    # 1 - sin(theta)^2 t^2, without a difference of equal numbers near the edge of a cap of 90 degrees.
    root = wp.sqrt(inside + parameter * parameter * t * t)
    return (1.0 + parameter) * inside / wp.max(root + parameter, 1.0e-12)


@made_once
def path_kernel(supersampling: int, has_chains: bool) -> Any:
    """Kernel ``print_paths``; joined rows, and lines that merge, need ``has_chains``: memory for a cell's points."""
    points = supersampling * supersampling
    heights_type = wp.types.vector(length=points if has_chains else 1, dtype=wp.float32)

    @no_type_check
    @wp.kernel(enable_backward=False, module="unique")
    def print_paths(
        rows: wp.array3d[wp.float32],
        boxes: wp.array3d[wp.float32],
        traits: wp.array2d[wp.float32],
        pitch_x: wp.float32,
        pitch_y: wp.float32,
        samples: wp.int32,
        # outputs
        heights: wp.array3d[wp.float32],
    ):
        """Heights [B, n, n] [m] of rows [B, L, 7], boxes [B, ceil(L / BLOCK), 5] and traits [B, 11]."""
        b, i, j = wp.tid()
        pitch = wp.vec2(pitch_x, pitch_y)
        kind = traits[b, 0]
        parameter = traits[b, 1]
        ends = traits[b, 2]
        merging = traits[b, 3]
        takes_highest = merging > 1.0e6
        centre = cell_point(i, j, -1, wp.static(supersampling), pitch, samples)
        total = wp.float32(0.0)
        # Of finished lines, and of the one that is being printed.
        sums = heights_type()
        line = heights_type()
        is_open = wp.bool(False)
        for block in range(boxes.shape[1]):
            if (
                centre[0] + 0.5 * pitch_x < boxes[b, block, 0]
                or centre[0] - 0.5 * pitch_x > boxes[b, block, 2]
                or centre[1] + 0.5 * pitch_y < boxes[b, block, 1]
                or centre[1] - 0.5 * pitch_y > boxes[b, block, 3]
            ):
                if wp.static(has_chains):  # noqa: SIM102 - one is compiled away, the other runs
                    # The line before may end in here; what begins in here does not reach this cell within the block.
                    if is_open and boxes[b, block, 4] > 0.5 and not takes_highest:
                        for sub in range(wp.static(points)):
                            sums[sub] = printed_over(sums[sub], line[sub], merging)
                        line = heights_type()
                        is_open = False
            else:
                for k in range(wp.static(BLOCK) * block, wp.min(wp.static(BLOCK) * (block + 1), rows.shape[1])):
                    row_kind = rows[b, k, 0]
                    end_width = rows[b, k, 5]
                    end_height = rows[b, k, 6]
                    width = end_width
                    height = end_height
                    if wp.static(has_chains):
                        if row_kind == wp.static(JOINED):
                            before = wp.max(k - 1, 0)
                            width = rows[b, before, 5]
                            height = rows[b, before, 6]
                        elif is_open and not takes_highest:
                            for sub in range(wp.static(points)):
                                sums[sub] = printed_over(sums[sub], line[sub], merging)
                            line = heights_type()
                            is_open = False
                    if row_kind != wp.static(BEGIN) and (height > 0.0 or end_height > 0.0):
                        is_ring = row_kind == wp.static(RING)
                        start = wp.vec2(rows[b, k, 1], rows[b, k, 2])
                        along = wp.vec2(rows[b, k, 3], rows[b, k, 4]) - start
                        radius = rows[b, k, 3]
                        inverse = 1.0 / wp.max(wp.dot(along, along), 1.0e-20)
                        reach = 0.5 * (ends * wp.max(width, end_width) + pitch_x + pitch_y)
                        for sub in range(-1, wp.static(points)):
                            # The first round is the cell's centre: most rows pass far from it.
                            offset = cell_point(i, j, sub, wp.static(supersampling), pitch, samples) - start
                            distance = wp.float32(0.0)
                            nearest = wp.float32(0.0)
                            if is_ring:
                                distance = wp.abs(wp.length(offset) - radius)
                            else:
                                gap = segment_gap(offset, along, inverse)
                                distance = wp.sqrt(gap[0] * gap[0] + gap[1] * gap[1])
                                nearest = gap[2]
                            if sub < 0:
                                if distance > reach:
                                    break
                                is_open = True
                            else:
                                wide = width + nearest * (end_width - width)
                                if distance < 0.5 * ends * wide:
                                    crown = height + nearest * (end_height - height)
                                    found = crown * path_section_height(kind, parameter, ends, distance, wide)
                                    if wp.static(has_chains):
                                        line[sub] = wp.max(line[sub], found)
                                    else:
                                        total += found
        if wp.static(has_chains):
            for sub in range(wp.static(points)):
                total += printed_over(sums[sub], line[sub], merging)
        x = centre[0]
        y = centre[1]
        bow = traits[b, 4] * x * x + traits[b, 5] * x * y + traits[b, 6] * y * y
        wave = traits[b, 7] * wp.sin(traits[b, 8] * x + traits[b, 9] * y + traits[b, 10])
        heights[b, i, j] = total / wp.float32(wp.static(points)) + bow + wave

    return print_paths
