"""The whole photon in one kernel, for any number of wavelengths at once.

Surface, refraction, footprint and pixels: no records are stored, and nothing but the image is written. The
formulas are in ``collimated.py`` and ``general.py``, the rule for pixels in ``pixels.py``.

Width 1: wavelength by wavelength, images [B, C, H, W].

Width 2 to ``PACK``, for GPUs: all wavelengths of a photon together, images [B, H, W, PACK] with the wavelengths side
by side. A pixel is then one addition of 16 bytes instead of one per wavelength, which is what a splat of small
footprints waits for. The footprints of a photon nearly coincide, since dispersion is small; all are evaluated over
the union of their windows. Where they are further apart than that, each wavelength is done on its own.
"""

from types import SimpleNamespace
from typing import Any, no_type_check

import warp as wp

from warp_caustics.kernels.collimated import collimated_functions
from warp_caustics.kernels.effects import PLAIN, Effects
from warp_caustics.kernels.fixed_point import sum_type
from warp_caustics.kernels.footprint import footprint_struct
from warp_caustics.kernels.general import general_functions
from warp_caustics.kernels.made_once import made_once
from warp_caustics.kernels.native import PACK, pixel_loader
from warp_caustics.kernels.photons import bench_functions, photons_struct
from warp_caustics.kernels.pixels import adding_functions
from warp_caustics.kernels.surface import photon_function, photon_struct
from warp_caustics.kernels.wide import BLOCK_ROWS, wide_functions

GPU_OPTIONS = {"fast_math": True}
"""Of modules that only GPUs run: quotients, roots and exponentials in float32 to two units in the last place, which is
what positions are good to anyhow. A tenth of the time of image and gradient."""

APART_SIGMAS, APART_PX = 3.0, 2.0
"""Wavelengths whose centres are further apart than so many standard deviations and pixels are done one by one."""


@made_once
def footprints_function(dtype: Any, width: int, effects: Effects, is_fixed: bool = False) -> Any:
    """``footprints``: those of a photon at ``width`` neighbouring wavelengths; with light in steps if ``is_fixed``."""
    light = (collimated_functions if effects.is_straight else general_functions)(dtype, effects)
    refraction, footprint = light.refraction, light.footprint
    bench = bench_functions(dtype, effects)
    optics_of, colour_of = bench.optics_of, bench.colour_of
    Photon, Photons = photon_struct(dtype), photons_struct(dtype)
    Footprints = footprint_struct(dtype, width)
    vector = wp.types.vector(length=width, dtype=dtype)
    is_blocked = effects.second_hits
    zero = wp.constant(dtype(0.0))

    @no_type_check
    @wp.func
    def footprints(photon: Photon, first_channel: wp.int32, photons: Photons, b: wp.int32, p: wp.int32):
        column = vector()
        row = vector()
        sigma_x = vector()
        sigma_y = vector()
        beta = vector()
        amplitude = vector()
        optics = optics_of(photons, b)
        for k in range(wp.static(width)):
            c = first_channel + k
            colour = colour_of(photons, b, c)
            f = footprint(photon, colour, refraction(photon, colour, optics), optics)
            column[k] = f.column
            row[k] = f.row
            sigma_x[k] = f.sigma_x
            sigma_y[k] = f.sigma_y
            beta[k] = f.beta
            amplitude[k] = f.amplitude
            if wp.static(is_fixed):
                amplitude[k] = wp.min(f.amplitude * photons.optics.steps, photons.optics.most_steps)
            if wp.static(is_blocked):
                if photons.clear[b, c, p] == wp.uint8(0):
                    amplitude[k] = zero
        return Footprints(column, row, sigma_x, sigma_y, beta, amplitude)

    return footprints


@made_once
def _extent_function(dtype: Any, profile: str, width: int) -> Any:
    """``extent``: pixels that the widest footprint with light covers, and whether some are too far apart."""
    covered_pixels = wide_functions(dtype, profile, width > 1).covered_pixels
    Footprints = footprint_struct(dtype, width)
    zero = wp.constant(dtype(0.0))
    apart_sigmas = wp.constant(dtype(APART_SIGMAS))
    apart_px = wp.constant(dtype(APART_PX))

    @no_type_check
    @wp.func
    def extent(f: Footprints):
        most = zero
        wide = zero
        high = zero
        left = dtype(1.0e30)
        right = dtype(-1.0e30)
        bottom = dtype(1.0e30)
        top = dtype(-1.0e30)
        for k in range(wp.static(width)):
            if f.amplitude[k] != zero:
                most = wp.max(most, covered_pixels(f.sigma_x[k], f.sigma_y[k]))
                wide = wp.max(wide, f.sigma_x[k])
                high = wp.max(high, f.sigma_y[k])
                left = wp.min(left, f.column[k])
                right = wp.max(right, f.column[k])
                bottom = wp.min(bottom, f.row[k])
                top = wp.max(top, f.row[k])
        is_apart = right - left > apart_sigmas * wide + apart_px or top - bottom > apart_sigmas * high + apart_px
        return most, is_apart

    return extent


@made_once
def fused_kernels(
    dtype: Any,
    profile: str,
    is_lattice: bool,
    width: int,
    lanes: int,
    defers: bool,
    effects: Effects = PLAIN,
    is_fixed: bool = False,
) -> SimpleNamespace:
    """Kernels ``splat_photons`` and ``splat_deferred``.

    Args:
        dtype: wp.float32 or wp.float64.
        profile: shape of the footprint, one of ``PROFILES``.
        is_lattice: photons lie on a grid (positions are its axes) instead of anywhere.
        width: wavelengths done at once, 1 or all of 2 to ``PACK`` (see the module's docstring).
        lanes: threads that share a footprint's columns; 1 for compact ones, several for wide ones on a GPU.
        defers: wide footprints are put on a list, for the ``deferred`` kernel of a variant with many lanes.
        effects: beyond refraction.
        is_fixed: images are whole numbers, of ``Optics.steps`` per W/m^2: the same in whatever order photons come. For
            width 1: integers are added one by one, and a list of blocks may be full, by chance.
    """
    is_packed = width > 1
    # GPU variants have several lanes or leave wide footprints to those that have.
    in_registers = lanes == 1 and not defers and not is_packed and not is_fixed
    options = {} if in_registers else GPU_OPTIONS
    adding = adding_functions(dtype, profile, width, lanes, is_packed, in_registers, is_fixed)
    adding_alone = adding_functions(dtype, profile, 1, lanes, is_packed, in_registers, is_fixed)
    sums = sum_type(dtype, is_fixed)
    row_window, add_rows = adding.row_window, adding.add_rows
    row_window_of, add_rows_of = adding_alone.row_window, adding_alone.add_rows
    footprints = footprints_function(dtype, width, effects, is_fixed)
    footprint_of = footprints_function(dtype, 1, effects, is_fixed)
    extent, put_off = _extent_function(dtype, profile, width), wide_functions(dtype, profile, is_packed).put_off
    photon_at = photon_function(dtype, is_lattice)
    Photon, Photons = photon_struct(dtype), photons_struct(dtype)
    Footprints = footprint_struct(dtype, width)
    zero = wp.constant(dtype(0.0))

    @no_type_check
    @wp.func
    def add(
        photon: Photon,
        f: Footprints,
        is_apart: wp.bool,
        photons: Photons,
        b: wp.int32,
        p: wp.int32,
        c: wp.int32,
        block: wp.int32,
        rows: wp.int32,
        lane: wp.int32,
        image: wp.array4d[sums],
    ):
        """Add a block of so many rows of a photon's footprints to image b."""
        if wp.static(is_packed):
            if is_apart:
                for k in range(photons.spectra.shape[2]):
                    f_k = footprint_of(photon, k, photons, b, p)
                    first, last = row_window_of(f_k, image)
                    first += block * rows
                    add_rows_of(f_k, first, wp.min(last, first + rows - 1), b, k, lane, image)
            else:
                first, last = row_window(f, image)
                first += block * rows
                add_rows(f, first, wp.min(last, first + rows - 1), b, c, lane, image)
        else:
            first, last = row_window(f, image)
            add_rows(f, first, last, b, c, lane, image)

    @no_type_check
    @wp.func
    def splat_group(
        photon: Photon,
        c: wp.int32,
        item: wp.int32,
        photons: Photons,
        b: wp.int32,
        p: wp.int32,
        lane: wp.int32,
        image: wp.array4d[sums],
        listed: wp.array2d[wp.int32],
        count: wp.array[wp.int32],
    ):
        """Add a photon's footprints at wavelengths c ... c + width - 1, or put them on the list as ``item``."""
        f = footprints(photon, c, photons, b, p)
        if wp.max(f.amplitude) > zero:
            is_apart = False
            here = True
            if wp.static(defers):
                most, is_apart = extent(f)
                if most > photons.optics.wide_pixels:
                    first, last = row_window(f, image)
                    here = first <= last
                    if here:
                        here = not put_off(item, first, last, lane, listed, count)
            if here:
                add(photon, f, is_apart, photons, b, p, c, 0, image.shape[1], lane, image)

    @no_type_check
    @wp.kernel(enable_backward=False, module="unique", module_options=options)
    def splat_photons(
        coefficients: wp.array3d[dtype],
        photons: Photons,
        # outputs
        image: wp.array4d[sums],
        listed: wp.array2d[wp.int32],
        count: wp.array[wp.int32],
    ):
        """Add the photons to the image [W/m^2], but for wide footprints if asked for: ``listed``, ``count`` of them.

        Spline coefficients [B, n + 4, n + 4].
        """
        b, p, lane = wp.tid()
        photon = photon_at(coefficients, photons, b, p)
        item = b * photons.count + p
        if wp.static(is_packed):
            splat_group(photon, 0, item, photons, b, p, lane, image, listed, count)
        else:
            channels = image.shape[1]
            for c in range(channels):
                splat_group(photon, c, item * channels + c, photons, b, p, lane, image, listed, count)

    @no_type_check
    @wp.kernel(enable_backward=False, module="unique", module_options=options)
    def splat_deferred(
        coefficients: wp.array3d[dtype],
        photons: Photons,
        groups: wp.int32,
        listed: wp.array2d[wp.int32],
        count: wp.array[wp.int32],
        # outputs
        image: wp.array4d[sums],
    ):
        """Add the footprints on the list; a group of threads shares the columns of each."""
        group, lane = wp.tid()
        for entry in range(group, wp.min(count[0], listed.shape[0]), groups):
            item = listed[entry, 0]
            if item >= 0:
                # --- whose footprints, and which of their rows
                c = wp.int32(0)
                block = wp.int32(0)
                rows = image.shape[1]
                if wp.static(is_packed):
                    block = listed[entry, 1]
                    rows = wp.static(BLOCK_ROWS)
                else:
                    c = item % image.shape[1]
                    item = item // image.shape[1]
                b = item // photons.count
                # --- once more, and to pixels
                p = item - b * photons.count
                photon = photon_at(coefficients, photons, b, p)
                f = footprints(photon, c, photons, b, p)
                is_apart = False
                if wp.static(is_packed):
                    _, is_apart = extent(f)
                add(photon, f, is_apart, photons, b, p, c, block, rows, lane, image)

    return SimpleNamespace(splat_photons=splat_photons, splat_deferred=splat_deferred)


@made_once
def unpack_kernel(dtype: Any) -> Any:
    """Kernel from packed images [B, H, W, PACK] to images [B, C, H, W]."""
    load = pixel_loader(dtype)

    @no_type_check
    @wp.kernel(enable_backward=False, module="unique")
    def unpack(packed: wp.array4d[dtype], image: wp.array4d[dtype]):
        b, i, j = wp.tid()
        light = load(packed, b, i, j)
        for c in range(wp.static(PACK)):
            if c < image.shape[1]:
                image[b, c, i, j] = light[c]

    return unpack
