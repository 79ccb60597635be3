"""The list of wide footprints: left by the first launch to a second one, where many threads share each.

Otherwise a launch would wait for the few photons with footprints of thousands of pixels.
"""

from types import SimpleNamespace
from typing import Any, no_type_check

import warp as wp

from warp_caustics.kernels.made_once import made_once
from warp_caustics.kernels.profiles import REACH

BLOCK_ROWS = 16
"""Rows of a footprint that a group of threads works on at a time, where the list is one of blocks."""


@made_once
def wide_functions(dtype: Any, profile: str, in_blocks: bool) -> SimpleNamespace:
    """``covered_pixels`` and ``put_off``.

    Args:
        dtype: wp.float32 or wp.float64.
        profile: shape of the footprint, one of ``PROFILES``.
        in_blocks: the list [size, 2] holds footprints' numbers and blocks of rows, and may be full; otherwise
            [size, 1] numbers alone, with room for all.
    """
    one = wp.constant(dtype(1.0))
    both_sides = wp.constant(dtype(2.0 * REACH[profile]))

    @no_type_check
    @wp.func
    def covered_pixels(sigma_x: dtype, sigma_y: dtype):
        """Pixels that a footprint covers, about."""
        return (both_sides * sigma_x + one) * (both_sides * sigma_y + one)

    @no_type_check
    @wp.func
    def put_off(
        item: wp.int32,
        first: wp.int32,
        last: wp.int32,
        lane: wp.int32,
        listed: wp.array2d[wp.int32],
        count: wp.array[wp.int32],
    ):
        """List rows first to last of a footprint; False if the list is full. Blocks are for one lane only."""
        fits = True
        if wp.static(in_blocks):
            blocks = (last - first + wp.static(BLOCK_ROWS)) // wp.static(BLOCK_ROWS)
            begin = wp.atomic_add(count, 0, blocks)
            fits = begin + blocks <= listed.shape[0]
            for k in range(begin, wp.min(begin + blocks, listed.shape[0])):
                listed[k, 0] = wp.where(fits, item, -1)
                listed[k, 1] = k - begin
        elif lane == 0:
            listed[wp.atomic_add(count, 0, 1), 0] = item
        return fits

    return SimpleNamespace(covered_pixels=covered_pixels, put_off=put_off)
