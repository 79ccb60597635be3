"""Kernels for sensors of a whole batch: every random number follows from a photo's key and its pixel alone.

So a photo is the same whatever else is in the batch, and a batch is one launch: torch's generators would have to be
asked photo by photo.
"""

from types import SimpleNamespace
from typing import no_type_check

import warp as wp

from warp_caustics.kernels.made_once import made_once

EXPOSURE, FULL_WELL, READ, FRAMES, BLACK, STEPS, CONTRAST, GRAINS, FRESH, HOT = range(10)
"""Columns of what kernels are told about a sensor: see :class:`warp_caustics.camera.sensors.Sensors`."""

SPECKLE, FLAT_SPECKLE, DUST, HOT_PIXELS, PHOTO, DARK, FLAT = range(7)
"""What random numbers are for."""

OF_FULL, OF_READ, OF_FRAMES, OF_BLACK, OF_STEPS = (wp.constant(n) for n in (FULL_WELL, READ, FRAMES, BLACK, STEPS))
OF_EXPOSURE, OF_CONTRAST, OF_GRAINS, OF_FRESH, OF_HOT = (
    wp.constant(n) for n in (EXPOSURE, CONTRAST, GRAINS, FRESH, HOT)
)
FOR_DUST, FOR_HOT, FOR_PHOTO, FOR_DARK, FOR_FLAT = (wp.constant(n) for n in (DUST, HOT_PIXELS, PHOTO, DARK, FLAT))
MOST_CHARGE = wp.constant(4.0)
"""Full wells: beyond, everything is saturated, and numbers stay within a float's digits."""


@no_type_check
@wp.func
def stream(keys: wp.array2d[wp.int32], photo: wp.int32, purpose: wp.int32, index: wp.int32):
    """State of the random numbers of one pixel of one photo for one purpose."""
    first = wp.uint32(keys[photo, 0]) ^ (wp.uint32(purpose) * wp.uint32(668265263))
    state = wp.rand_init(wp.int32(first), index)
    return wp.rand_init(wp.int32(wp.uint32(keys[photo, 1]) ^ state), index)


@no_type_check
@wp.func
def read_out(
    charge: wp.float32,
    full: wp.float32,
    read: wp.float32,
    frames: wp.float32,
    black: wp.float32,
    steps: wp.float32,
    state: wp.uint32,
):
    """Mean of exposures to a charge, as parts of full scale: exposure.exposed, with one Poisson number for the sum."""
    value = wp.clamp(charge, 0.0, MOST_CHARGE)
    if full > 0.0:
        electrons = wp.float32(wp.poisson(state, value * full * frames))
        electrons += read * wp.sqrt(frames) * wp.randn(state)
        value = electrons / (full * frames)
    value = wp.clamp(value + black, 0.0, 1.0)
    return wp.round(value * steps * frames) / (steps * frames)


@no_type_check
@wp.func
def grain_shadow(grains: wp.array3d[wp.float32], photo: wp.int32, grain: wp.int32, x: wp.float32, y: wp.float32):
    """Part of the light that a grain lets through, as defects.dust has it: its edge fades over a pixel."""
    radius = grains[photo, grain, 2]
    distance = wp.length(wp.vec2(x - grains[photo, grain, 0], y - grains[photo, grain, 1]))
    return 1.0 - grains[photo, grain, 3] * wp.clamp(radius - distance + 0.5, 0.0, 1.0)


@made_once
def sensor_kernels() -> SimpleNamespace:
    """Kernels ``white``, ``filter_columns``, ``filter_rows``, ``place_grains`` and ``expose``."""

    @no_type_check
    @wp.kernel(enable_backward=False, module="unique")
    def white(
        keys: wp.array2d[wp.int32],
        purpose: wp.int32,
        # outputs
        noise: wp.array2d[wp.float32],
    ):
        """White noise of standard deviation 1, [B, N]."""
        photo, index = wp.tid()
        state = stream(keys, photo, purpose, index)
        noise[photo, index] = wp.randn(state)

    @no_type_check
    @wp.kernel(enable_backward=False, module="unique")
    def filter_columns(
        field: wp.array4d[wp.float32],
        taps: wp.array2d[wp.float32],
        # outputs
        filtered: wp.array4d[wp.float32],
    ):
        """Along the last axis, which loses what the filter reaches; a filter for each photo."""
        photo, channel, i, j = wp.tid()
        total = wp.float32(0.0)
        for k in range(taps.shape[1]):
            total += taps[photo, k] * field[photo, channel, i, j + k]
        filtered[photo, channel, i, j] = total

    @no_type_check
    @wp.kernel(enable_backward=False, module="unique")
    def filter_rows(
        field: wp.array4d[wp.float32],
        taps: wp.array2d[wp.float32],
        # outputs
        filtered: wp.array4d[wp.float32],
    ):
        """The same along the axis before."""
        photo, channel, i, j = wp.tid()
        total = wp.float32(0.0)
        for k in range(taps.shape[1]):
            total += taps[photo, k] * field[photo, channel, i + k, j]
        filtered[photo, channel, i, j] = total

    @no_type_check
    @wp.kernel(enable_backward=False, module="unique")
    def place_grains(
        keys: wp.array2d[wp.int32],
        width: wp.float32,
        height: wp.float32,
        radius: wp.vec2,
        depth: wp.vec2,
        # outputs
        grains: wp.array3d[wp.float32],
    ):
        """Grains anywhere: x, y, radius [px] and the light that they take."""
        photo, grain = wp.tid()
        state = stream(keys, photo, FOR_DUST, grain)
        grains[photo, grain, 0] = wp.randf(state) * width - 0.5
        grains[photo, grain, 1] = wp.randf(state) * height - 0.5
        grains[photo, grain, 2] = wp.randf(state, radius[0], radius[1])
        grains[photo, grain, 3] = wp.randf(state, depth[0], depth[1])

    @no_type_check
    @wp.kernel(enable_backward=False, module="unique")
    def expose(
        keys: wp.array2d[wp.int32],
        sensors: wp.array2d[wp.float32],
        signal: wp.array4d[wp.float32],
        lit: wp.array4d[wp.float32],
        speckle: wp.array4d[wp.float32],
        flat_speckle: wp.array4d[wp.float32],
        grains: wp.array3d[wp.float32],
        level: wp.float32,
        hot_level: wp.vec2,
        # outputs
        photos: wp.array4d[wp.float32],
        darks: wp.array4d[wp.float32],
        flats: wp.array4d[wp.float32],
    ):
        """Photo, dark and flat frame as parts of full scale, of light [W/m^2]; without speckle its arrays are empty."""
        photo, i, j = wp.tid()
        x = wp.float32(j)
        y = wp.float32(i)
        settled = wp.float32(1.0)
        fresh = wp.float32(1.0)
        old = wp.int32(sensors[photo, OF_GRAINS])
        for grain in range(old + wp.int32(sensors[photo, OF_FRESH])):
            passed = grain_shadow(grains, photo, grain, x, y)
            if grain < old:
                settled *= passed
            else:
                fresh *= passed
        scale = sensors[photo, OF_EXPOSURE] / level
        # Log-normal of mean 1: speckle.speckle.
        variance = wp.log(1.0 + sensors[photo, OF_CONTRAST] * sensors[photo, OF_CONTRAST])
        full = sensors[photo, OF_FULL]
        read = sensors[photo, OF_READ]
        black = sensors[photo, OF_BLACK]
        steps = sensors[photo, OF_STEPS]
        frames = sensors[photo, OF_FRAMES]
        pixels = signal.shape[2] * signal.shape[3]
        share = sensors[photo, OF_HOT] / wp.float32(pixels * signal.shape[1])
        for channel in range(signal.shape[1]):
            index = (channel * signal.shape[2] + i) * signal.shape[3] + j
            light = signal[photo, channel, i, j] * scale * settled * fresh
            flat = lit[photo, channel, i, j] * scale * settled
            if speckle.shape[0] > 0:
                light *= wp.exp(wp.sqrt(variance) * speckle[photo, channel, i, j] - 0.5 * variance)
                flat *= wp.exp(wp.sqrt(variance) * flat_speckle[photo, channel, i, j] - 0.5 * variance)
            hot = wp.float32(0.0)
            if share > 0.0:
                at = stream(keys, photo, FOR_HOT, index)
                if wp.randf(at) < share:
                    hot = wp.randf(at, hot_level[0], hot_level[1])
            of_photo = stream(keys, photo, FOR_PHOTO, index)
            photos[photo, channel, i, j] = read_out(light + hot, full, read, 1.0, black, steps, of_photo)
            if darks.shape[0] > 0:
                of_dark = stream(keys, photo, FOR_DARK, index)
                darks[photo, channel, i, j] = read_out(hot, full, read, frames, black, steps, of_dark)
                of_flat = stream(keys, photo, FOR_FLAT, index)
                flats[photo, channel, i, j] = read_out(flat + hot, full, read, frames, black, steps, of_flat)

    return SimpleNamespace(
        white=white,
        filter_columns=filter_columns,
        filter_rows=filter_rows,
        place_grains=place_grains,
        expose=expose,
    )
