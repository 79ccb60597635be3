"""Kernels of lines along chains of points: corners and curves, which are not doubled where a line turns.

A line is as high at a place as its distance from the nearest part of its chain says. Chains are told at the same number
of points, a multiple of ``BLOCK`` and one more, in blocks with a box around each: a cell looks only at those near it.
"""

from typing import no_type_check

import warp as wp

from warp_caustics.prints.kernels import across, cell_point, segment_gap, steep_edge

BLOCK = 8
"""Pieces of one box."""
TILE = 16
"""Cells beside each other that one thread prints."""


@wp.struct
class ChainSection:
    """What all lines have in common: see :class:`~warp_caustics.prints.line_shape.Shape`, but for thicker ends."""

    exponent: wp.float32
    parabola: wp.float32
    edge: wp.float32
    is_cap: wp.bool


@wp.struct
class ChainPoint:
    """A point beside a chain."""

    gap: wp.vec2
    """From the nearest part of the chain [m]."""
    piece: wp.int32
    share: wp.float32
    """The piece that this is on, and how far along it, from 0 at its start to 1."""
    distance: wp.float32
    """The gap's length [m]."""


@no_type_check
@wp.func
def box_distance(boxes: wp.array3d[wp.float32], k: wp.int32, block: wp.int32, place: wp.vec2):
    """From a place to a box (x_low, y_low, x_high, y_high) [m]; 0 within."""
    x = wp.max(wp.max(boxes[k, block, 0] - place[0], place[0] - boxes[k, block, 2]), 0.0)
    y = wp.max(wp.max(boxes[k, block, 1] - place[1], place[1] - boxes[k, block, 3]), 0.0)
    return wp.sqrt(x * x + y * y)


@no_type_check
@wp.func
def nearest_of_chain(
    points: wp.array3d[wp.float32],
    boxes: wp.array3d[wp.float32],
    k: wp.int32,
    first: wp.int32,
    last: wp.int32,
    place: wp.vec2,
    within: wp.float32,
) -> ChainPoint:
    """The part of chain k that is nearest to a place [m], in blocks from ``first`` to before ``last``.

    Farther than ``within`` [m] nothing is looked for; ``piece`` is -1 then.
    """
    found = ChainPoint()
    found.piece = wp.int32(-1)
    found.distance = within
    for block in range(first, last):
        if box_distance(boxes, k, block, place) < found.distance:
            for piece in range(wp.static(BLOCK) * block, wp.static(BLOCK) * (block + 1)):
                start = wp.vec2(points[k, piece, 0], points[k, piece, 1])
                along = wp.vec2(points[k, piece + 1, 0], points[k, piece + 1, 1]) - start
                nearest = segment_gap(place - start, along, 1.0 / wp.max(wp.dot(along, along), 1.0e-20))
                gap = wp.vec2(nearest[0], nearest[1])
                distance = wp.length(gap)
                if distance < found.distance:
                    found.distance = distance
                    found.gap = gap
                    found.piece = piece
                    found.share = nearest[2]
    return found


@no_type_check
@wp.func
def blocks_of_tile(boxes: wp.array3d[wp.float32], k: wp.int32, first: wp.vec2, last: wp.vec2, reach: wp.float32):
    """First block of a chain, and the one behind the last, within a reach of a tile (corners) [m]; (0, 0) for none."""
    found = wp.vec2i(0, 0)
    for block in range(boxes.shape[1]):
        x = wp.max(boxes[k, block, 0] - last[0], first[0] - boxes[k, block, 2])
        y = wp.max(boxes[k, block, 1] - last[1], first[1] - boxes[k, block, 3])
        if x <= reach and y <= reach:
            if found[1] == 0:
                found[0] = block
            found[1] = block + 1
    return found


@no_type_check
@wp.func
def blocks_of_cell(
    points: wp.array3d[wp.float32],
    boxes: wp.array3d[wp.float32],
    k: wp.int32,
    near: wp.vec2i,
    centre: wp.vec2,
    reach: wp.float32,
    diagonal: wp.float32,
):
    """Of the blocks ``near`` the first, and the one behind the last, that a point of a cell may be nearest to."""
    found = wp.vec2i(0, 0)
    nearest = nearest_of_chain(points, boxes, k, near[0], near[1], centre, reach)
    if nearest.piece >= 0:
        for block in range(near[0], near[1]):
            if box_distance(boxes, k, block, centre) <= nearest.distance + diagonal:
                if found[1] == 0:
                    found[0] = block
                found[1] = block + 1
    return found


@no_type_check
@wp.func
def tile_blocks(
    boxes: wp.array3d[wp.float32],
    k: wp.int32,
    i: wp.int32,
    tile: wp.int32,
    reach: wp.float32,
    cell: wp.vec2,
    n: wp.int32,
):
    """Blocks of a chain near the cells of a tile in row i."""
    return blocks_of_tile(
        boxes,
        k,
        cell_point(i, wp.static(TILE) * tile, -1, 1, cell, n),
        cell_point(i, wp.static(TILE) * (tile + 1) - 1, -1, 1, cell, n),
        reach,
    )


@no_type_check
@wp.kernel(enable_backward=False)
def chain_heights(
    points: wp.array3d[wp.float32],
    boxes: wp.array3d[wp.float32],
    sizes: wp.array2d[wp.float32],
    section: ChainSection,
    cell: wp.vec2,
    samples: wp.int32,
    supersampling: wp.int32,
    # outputs
    heights: wp.array4d[wp.float32],
):
    """Heights [L, n, n, 1] [m] of single lines along points [L, K, 2] [m], of widths and heights [L, 2] [m].

    Means of cells; at their points where ``heights`` are as many.
    """
    k, i, tile = wp.tid()
    count = supersampling * supersampling
    is_mean = heights.shape[3] < count
    diagonal = cell[0] + cell[1]
    half = 0.5 * section.edge * sizes[k, 0]
    reach = half + 0.5 * diagonal
    side = 0.5 * diagonal / wp.float32(supersampling)
    near = tile_blocks(boxes, k, i, tile, reach, cell, samples)
    for j in range(wp.static(TILE) * tile, wp.min(wp.static(TILE) * (tile + 1), samples)):
        total = wp.float32(0.0)
        if not is_mean:
            for sub in range(count):
                heights[k, i, j, sub] = 0.0
        if near[1] > 0:
            centre = cell_point(i, j, -1, supersampling, cell, samples)
            blocks = blocks_of_cell(points, boxes, k, near, centre, reach, diagonal)
            if blocks[1] > 0:
                for sub in range(count):
                    place = cell_point(i, j, sub, supersampling, cell, samples)
                    at = nearest_of_chain(points, boxes, k, blocks[0], blocks[1], place, half)
                    if at.piece >= 0:
                        told = across(
                            section.exponent,
                            section.parabola,
                            section.edge,
                            section.is_cap,
                            at.distance,
                            sizes[k, 0],
                            sizes[k, 1],
                            side,
                            False,
                        )
                        total += told[0]
                        if not is_mean:
                            heights[k, i, j, sub] = told[0]
        if is_mean:
            heights[k, i, j, 0] = total / wp.float32(count)


@no_type_check
@wp.kernel(enable_backward=False)
def chain_heights_adjoint(
    points: wp.array3d[wp.float32],
    boxes: wp.array3d[wp.float32],
    sizes: wp.array2d[wp.float32],
    section: ChainSection,
    cell: wp.vec2,
    samples: wp.int32,
    supersampling: wp.int32,
    grad_heights: wp.array4d[wp.float32],
    # outputs
    grad_points: wp.array3d[wp.float32],
    grad_sizes: wp.array2d[wp.float32],
):
    """Adds to the gradients by points [L, K, 2] and sizes [L, 2] from that by heights as of :func:`chain_heights`."""
    k, i, tile = wp.tid()
    count = supersampling * supersampling
    is_mean = grad_heights.shape[3] < count
    diagonal = cell[0] + cell[1]
    half = 0.5 * section.edge * sizes[k, 0]
    reach = half + 0.5 * diagonal
    side = 0.5 * diagonal / wp.float32(supersampling)
    is_steep = steep_edge(section.exponent, section.parabola, section.edge)
    beyond = wp.float32(0.0)
    if is_steep:
        # Sections that are steep at their edge have a slope a little beyond it.
        beyond = 0.5 * side
    near = tile_blocks(boxes, k, i, tile, reach, cell, samples)
    if near[1] > 0:
        for j in range(wp.static(TILE) * tile, wp.min(wp.static(TILE) * (tile + 1), samples)):
            grad = grad_heights[k, i, j, 0] / wp.float32(count)
            centre = cell_point(i, j, -1, supersampling, cell, samples)
            blocks = blocks_of_cell(points, boxes, k, near, centre, reach, diagonal)
            if blocks[1] > 0:
                for sub in range(count):
                    place = cell_point(i, j, sub, supersampling, cell, samples)
                    at = nearest_of_chain(points, boxes, k, blocks[0], blocks[1], place, half + beyond)
                    if at.piece >= 0:
                        if not is_mean:
                            grad = grad_heights[k, i, j, sub]
                        told = across(
                            section.exponent,
                            section.parabola,
                            section.edge,
                            section.is_cap,
                            at.distance,
                            sizes[k, 0],
                            sizes[k, 1],
                            side,
                            is_steep,
                        )
                        # Another nearest part when the chain moves changes the distance in second order only.
                        outward = grad * told[1] / wp.max(at.distance, 1.0e-15) * at.gap
                        wp.atomic_add(grad_sizes, k, 0, grad * told[2])
                        wp.atomic_add(grad_sizes, k, 1, grad * told[3])
                        for axis in range(2):
                            wp.atomic_add(grad_points, k, at.piece, axis, -(1.0 - at.share) * outward[axis])
                            wp.atomic_add(grad_points, k, at.piece + 1, axis, -at.share * outward[axis])
