"""Kernels of a GPU for lines that are fitted to a relief: what a launch is told stands in its memory, not in its call.

So a CUDA graph of them serves all lines and shapes. Products of what they leave are the normal equations:
:class:`~warp_caustics.prints.fit_system.FitSystem`.
"""

from typing import no_type_check

import warp as wp

from warp_caustics.prints.line_kernels import line_cell
from warp_caustics.prints.overlap import LEAST, TINY_M

LEAST_OVERLAP, TINIEST_M = wp.constant(LEAST), wp.constant(TINY_M)


@no_type_check
@wp.func
def over(height: wp.float32, other: wp.float32, q: wp.float32):
    """overlap.over of two heights [m]."""
    if q == 1.0:
        return height + other
    highest = wp.max(height, other)
    if q < LEAST_OVERLAP:
        return highest
    lower = wp.max(wp.min(height, other), 0.0) / wp.max(highest, TINIEST_M)
    return highest * wp.pow(1.0 + wp.pow(lower, 1.0 / q), q)


@no_type_check
@wp.func
def share(height: wp.float32, total: wp.float32, q: wp.float32):
    """overlap.share of a height in all of them [1]."""
    if q == 1.0:
        return 1.0
    if q < LEAST_OVERLAP:
        if height >= total:
            return 1.0
        return 0.0
    return wp.pow(wp.clamp(height / wp.max(total, TINIEST_M), 0.0, 1.0), 1.0 / q - 1.0)


@no_type_check
@wp.kernel(enable_backward=False)
def lines_alone(
    lines: wp.array2d[wp.float32],
    traits: wp.array[wp.float32],
    pitch_x: wp.float32,
    pitch_y: wp.float32,
    samples: wp.int32,
    supersampling: wp.int32,
    # outputs
    heights: wp.array3d[wp.float32],
    jacobians: wp.array4d[wp.float32],
):
    """Heights [L, n, n] [m] of single lines [L, 6] (LINE_COLUMNS), and derivatives [1].

    ``jacobians`` are blocks of rows of reliefs, shape [blocks L, more than 6, n / blocks, n].
    """
    k, i, j = wp.tid()
    found = line_cell(
        lines,
        k,
        i,
        j,
        traits[0],
        traits[1],
        traits[2],
        traits[3] > 0.5,
        wp.vec2(traits[4], traits[5]),
        wp.vec2(pitch_x, pitch_y),
        samples,
        supersampling,
    )
    heights[k, i, j] = found[0]
    rows = jacobians.shape[2]
    block = k * (samples // rows) + i // rows
    for number in range(6):
        jacobians[block, number, i % rows, j] = found[number + 1]


@no_type_check
@wp.func
def geman_mcclure(squared: wp.float32):
    """Loss of a squared residual in units of its expected size, and its weight (``fit.GEMAN_MCCLURE``)."""
    below = 1.0 + squared
    return wp.vec2(squared / below, 2.0 / (below * below))


@no_type_check
@wp.kernel(enable_backward=False)
def weigh_together(
    heights: wp.array3d[wp.float32],
    printed: wp.array2d[wp.float32],
    relief: wp.array2d[wp.float32],
    inverse_variance: wp.array2d[wp.float32],
    traits: wp.array[wp.float32],
    # outputs
    jacobians: wp.array4d[wp.float32],
    weighted: wp.array4d[wp.float32],
):
    """Of lines that are printed together, over others: shares of their derivatives, what is left, and all weighted.

    ``jacobians`` [L + 1, 6, n, n]: of each line its derivatives, and of what is no line in the first plane what is left
    [m]. Of ``weighted`` the loss is in the second; that of ``jacobians`` is one.
    """
    i, j = wp.tid()
    q = traits[6]
    count = heights.shape[0]
    total = printed[i, j]
    if q == 1.0:
        for k in range(count):
            total += heights[k, i, j]
    else:
        highest = total
        for k in range(count):
            highest = wp.max(highest, heights[k, i, j])
        if q >= LEAST_OVERLAP:
            powers = wp.pow(wp.max(total, 0.0) / wp.max(highest, TINIEST_M), 1.0 / q)
            for k in range(count):
                powers += wp.pow(heights[k, i, j] / wp.max(highest, TINIEST_M), 1.0 / q)
            total = highest * wp.pow(powers, q)
        else:
            total = highest
    left = relief[i, j] - total
    loss = geman_mcclure(left * left * inverse_variance[i, j])
    weight = loss[1] * inverse_variance[i, j]
    for k in range(count):
        part = share(heights[k, i, j], total, q)
        for number in range(6):
            by = part * jacobians[k, number, i, j]
            jacobians[k, number, i, j] = by
            weighted[k, number, i, j] = weight * by
    jacobians[count, 0, i, j] = left
    weighted[count, 0, i, j] = weight * left
    weighted[count, 1, i, j] = loss[0]


@no_type_check
@wp.kernel(enable_backward=False)
def weigh_each(
    heights: wp.array3d[wp.float32],
    printed: wp.array3d[wp.float32],
    relief: wp.array2d[wp.float32],
    inverse_variance: wp.array2d[wp.float32],
    traits: wp.array[wp.float32],
    # outputs
    jacobians: wp.array4d[wp.float32],
    weighted: wp.array4d[wp.float32],
):
    """The same of each line for itself, over what is printed beside it: its planes 6 and 7 are those of no line."""
    k, i, j = wp.tid()
    q = traits[6]
    total = over(heights[k, i, j], printed[k, i, j], q)
    left = relief[i, j] - total
    loss = geman_mcclure(left * left * inverse_variance[i, j])
    weight = loss[1] * inverse_variance[i, j]
    part = share(heights[k, i, j], total, q)
    rows = jacobians.shape[2]
    block = k * (relief.shape[0] // rows) + i // rows
    row = i % rows
    for number in range(6):
        by = part * jacobians[block, number, row, j]
        jacobians[block, number, row, j] = by
        weighted[block, number, row, j] = weight * by
    jacobians[block, 6, row, j] = left
    weighted[block, 6, row, j] = weight * left
    weighted[block, 7, row, j] = loss[0]
