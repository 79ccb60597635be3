"""All wavelengths of a photon at once, for GPUs: images [B, H, W, 4] with the channels side by side.

A pixel is then one addition of 16 bytes instead of one per channel, which is what a splat of small
footprints waits for. The footprints of a photon nearly coincide, since dispersion is small; all are evaluated over
the union of their windows. Where they are further apart than that, each channel is done on its own.
"""

from functools import cache
from types import SimpleNamespace
from typing import Any, no_type_check

import warp as wp

from warp_caustics.kernels.collimated import collimated_functions
from warp_caustics.kernels.splat import REACH, window_functions
from warp_caustics.kernels.surface import surface_functions
from warp_caustics.kernels.trace import optics_struct

PACK = 4
"""Channels of a packed image; unused ones stay zero."""

BLOCK_ROWS = 16
"""Rows of a wide footprint that a group of threads works on at a time."""

APART_SIGMAS, APART_PX = 3.0, 2.0
"""Channels whose centres are further apart than so many standard deviations and pixels are done one by one."""

_ADD = """
    {real}* pixel = packed.data + ((size_t(b) * packed.shape[1] + i) * packed.shape[2] + j) * 4;
#if {is_vector} && defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 900
    asm volatile("red.global.add.v4.f32 [%0], {{%1, %2, %3, %4}};"
                 :: "l"(pixel), "f"({light[0]}), "f"({light[1]}), "f"({light[2]}), "f"({light[3]}) : "memory");
#elif defined(__CUDA_ARCH__)
    for (int c = 0; c < {width}; ++c) atomicAdd(pixel + c, light[c]);
#else
    for (int c = 0; c < {width}; ++c) pixel[c] += light[c];
#endif
"""

_LOAD = """
    const {real}* pixel = packed.data + ((size_t(b) * packed.shape[1] + i) * packed.shape[2] + j) * 4;
    wp::vec_t<4, {real}> light;
#if {is_vector} && defined(__CUDA_ARCH__)
    float values[4];
    asm("ld.global.nc.v4.f32 {{%0, %1, %2, %3}}, [%4];"
        : "=f"(values[0]), "=f"(values[1]), "=f"(values[2]), "=f"(values[3]) : "l"(pixel));
    for (int c = 0; c < 4; ++c) light[c] = values[c];
#else
    for (int c = 0; c < 4; ++c) light[c] = pixel[c];
#endif
    return light;
"""


def _native_type(dtype: Any) -> dict[str, Any]:
    return {"real": {wp.float32: "float", wp.float64: "double"}[dtype], "is_vector": int(dtype is wp.float32)}


@cache
def _adder(dtype: Any, width: int) -> Any:
    """Adds ``width`` channels to a pixel."""
    vector = wp.types.vector(length=width, dtype=dtype)
    light = [f"light[{c}]" if c < width else "0.0f" for c in range(PACK)]

    @no_type_check
    @wp.func_native(_ADD.format(**_native_type(dtype), width=width, light=light))
    def add(packed: wp.array4d[dtype], b: wp.int32, i: wp.int32, j: wp.int32, light: vector): ...

    return add


@cache
def _loader(dtype: Any) -> Any:
    """Reads all channels of a pixel."""
    vector = wp.types.vector(length=PACK, dtype=dtype)

    @wp.func_native(_LOAD.format(**_native_type(dtype)))  # with no_type_check it would return nothing
    def load(packed: wp.array4d[dtype], b: wp.int32, i: wp.int32, j: wp.int32) -> vector: ...

    return load


@cache
def packed_functions(dtype: Any, profile: str, width: int, is_lattice: bool) -> SimpleNamespace:
    """Footprints of ``width`` neighbouring channels, their common window, and whether they go together.

    Args:
        dtype: wp.float32 or wp.float64.
        profile: shape of the footprint, one of ``PROFILES``.
        width: channels treated at once, 1 to ``PACK``.
        is_lattice: photons lie on a grid (positions are its axes) instead of anywhere.
    """
    surface_at = surface_functions(dtype).surface_at
    functions = collimated_functions(dtype, profile, is_lattice)
    refraction, footprint, place = functions.refraction, functions.footprint, functions.place
    first_pixel, last_pixel = window_functions(dtype, profile)
    Optics = optics_struct(dtype)
    zero = wp.constant(dtype(0.0))
    one = wp.constant(dtype(1.0))
    both_sides = wp.constant(dtype(2.0 * REACH[profile]))
    apart_sigmas = wp.constant(dtype(APART_SIGMAS))
    apart_px = wp.constant(dtype(APART_PX))
    vec6 = wp.types.vector(length=6, dtype=dtype)
    vec8 = wp.types.vector(length=8, dtype=dtype)
    vector = wp.types.vector(length=width, dtype=dtype)

    class Footprints:
        column: vector
        row: vector
        sigma_x: vector
        sigma_y: vector
        beta: vector
        amplitude: vector

    Footprints.__name__ = Footprints.__qualname__ = f"Footprints_{width}_{dtype.__name__}"
    Footprints = wp.struct(Footprints)

    @no_type_check
    @wp.func
    def start_of(
        coefficients: wp.array3d[dtype],
        positions: wp.array2d[dtype],
        b: wp.int32,
        p: wp.int32,
        columns: wp.int32,
        samples_per_m_x: dtype,
        samples_per_m_y: dtype,
        n: wp.int32,
    ):
        """Starting point of photon p and the surface maps there."""
        x, y = place(positions, p, columns)
        maps = surface_at(coefficients, b, x, y, samples_per_m_x, samples_per_m_y, n)
        return vec8(x, y, maps[0], maps[1], maps[2], maps[3], maps[4], maps[5])

    @no_type_check
    @wp.func
    def footprints(
        start: vec8,
        first_channel: wp.int32,
        eta: wp.array[dtype],
        ratio: wp.array[dtype],
        radiosity: wp.array[dtype],
        optics: Optics,
    ):
        maps = vec6(start[2], start[3], start[4], start[5], start[6], start[7])
        column = vector()
        row = vector()
        sigma_x = vector()
        sigma_y = vector()
        beta = vector()
        amplitude = vector()
        for k in range(wp.static(width)):
            c = first_channel + k
            f = footprint(start[0], start[1], maps, refraction(maps, eta[c], ratio[c]), radiosity[c], optics)
            column[k] = f[0]
            row[k] = f[1]
            sigma_x[k] = f[2]
            sigma_y[k] = f[3]
            beta[k] = f[4]
            amplitude[k] = f[5]
        found = Footprints()
        found.column = column
        found.row = row
        found.sigma_x = sigma_x
        found.sigma_y = sigma_y
        found.beta = beta
        found.amplitude = amplitude
        return found

    @no_type_check
    @wp.func
    def window(centre: vector, sigma: vector, size: wp.int32):
        """First and last pixel of the union of the channels' windows along an axis."""
        first = size
        last = wp.int32(-1)
        for k in range(wp.static(width)):
            begin = first_pixel(centre[k], sigma[k])
            end = last_pixel(centre[k], sigma[k], size)
            if begin <= end:
                first = wp.min(first, begin)
                last = wp.max(last, end)
        return first, last

    @no_type_check
    @wp.func
    def pixels(f: Footprints):
        """Pixels that the widest channel with light covers, and whether some are too far apart to go together."""
        most = zero
        wide = zero
        high = zero
        left = dtype(1.0e30)
        right = dtype(-1.0e30)
        bottom = dtype(1.0e30)
        top = dtype(-1.0e30)
        for k in range(wp.static(width)):
            if f.amplitude[k] != zero:
                sigma_x = f.sigma_x[k]
                sigma_y = f.sigma_y[k]
                most = wp.max(most, (both_sides * sigma_x + one) * (both_sides * sigma_y + one))
                wide = wp.max(wide, sigma_x)
                high = wp.max(high, sigma_y)
                left = wp.min(left, f.column[k])
                right = wp.max(right, f.column[k])
                bottom = wp.min(bottom, f.row[k])
                top = wp.max(top, f.row[k])
        is_apart = right - left > apart_sigmas * wide + apart_px or top - bottom > apart_sigmas * high + apart_px
        return most, is_apart

    @no_type_check
    @wp.func
    def put_off(
        photon: wp.int32,
        first: wp.int32,
        last: wp.int32,
        deferred: wp.array2d[wp.int32],
        deferred_count: wp.array[wp.int32],
    ):
        """List rows first to last in blocks for the other kernel; False if the list is full."""
        blocks = (last - first + wp.static(BLOCK_ROWS)) // wp.static(BLOCK_ROWS)
        begin = wp.atomic_add(deferred_count, 0, blocks)
        fits = begin + blocks <= deferred.shape[0]
        for k in range(begin, wp.min(begin + blocks, deferred.shape[0])):
            deferred[k, 0] = wp.where(fits, photon, -1)
            deferred[k, 1] = k - begin
        return fits

    return SimpleNamespace(
        Footprints=Footprints,
        vector=vector,
        start_of=start_of,
        footprints=footprints,
        window=window,
        pixels=pixels,
        put_off=put_off,
        add=_adder(dtype, width),
    )


@cache
def unpack_kernel(dtype: Any) -> Any:
    """Kernel from packed images [B, H, W, 4] to images [B, C, H, W]."""
    load = _loader(dtype)

    @no_type_check
    @wp.kernel(enable_backward=False, module="unique")
    def unpack(packed: wp.array4d[dtype], image: wp.array4d[dtype]):
        b, i, j = wp.tid()
        light = load(packed, b, i, j)
        for c in range(wp.static(PACK)):
            if c < image.shape[1]:
                image[b, c, i, j] = light[c]

    return unpack
