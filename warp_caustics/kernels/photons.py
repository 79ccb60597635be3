"""Where independent random photons start on the plate."""

from functools import cache
from types import SimpleNamespace
from typing import Any, no_type_check

import warp as wp


@cache
def photon_kernels(dtype: Any) -> SimpleNamespace:
    """Kernels for float32 or float64: ``place_random``."""
    scale = wp.constant(dtype(2.0**-32))
    half = wp.constant(dtype(0.5))

    @no_type_check
    @wp.kernel(enable_backward=False, module="unique")
    def place_random(
        key0: wp.uint32,
        key1: wp.uint32,
        first: wp.int64,
        jitter_columns: wp.int32,
        jitter_rows: wp.int32,
        length_x: dtype,
        length_y: dtype,
        # outputs
        positions: wp.array2d[dtype],
    ):
        """Independent uniform positions on the plate [m]; with jitter_columns > 0 one per cell of a grid.

        The stream of a photon depends on both keys and on its index alone, so
        chunks of any size, on any device, give the same photons.
        """
        tid = wp.tid()
        index = first + wp.int64(tid)
        low = wp.uint32(index & wp.int64(0xFFFFFFFF))
        high = wp.uint32(index >> wp.int64(32))
        # Two rounds of Warp's hash with a key word each: no seed is another seed plus an offset.
        state = wp.rand_init(wp.int32(key0 ^ high), wp.int32(low))
        state = wp.rand_init(wp.int32(key1 ^ state), wp.int32(low))
        u = (dtype(wp.randu(state)) + half) * scale
        v = (dtype(wp.randu(state)) + half) * scale
        if jitter_columns > 0:
            column = index % wp.int64(jitter_columns)
            row = index // wp.int64(jitter_columns)
            u = (dtype(column) + u) / dtype(jitter_columns)
            v = (dtype(row) + v) / dtype(jitter_rows)
        positions[tid, 0] = (u - half) * length_x
        positions[tid, 1] = (v - half) * length_y

    return SimpleNamespace(place_random=place_random)
