"""Adjoint of ``fused.py``, written by hand: from the image gradient to that of the surface maps.

Every photon repeats its forward pass, takes the moments of the image gradient under its footprints, and goes
back through covariance, Jacobian and refraction. It reads the image and writes its own six numbers: no atomics, and the
same result every time, unless several threads share a photon or a footprint. Then threads add to one number, in any
order; with ``in_order`` they are two, whose order does not matter, or those of a warp, which are added in a fixed one.

Always wavelength by wavelength, on images [B, C, H, W]: it only reads, and is slower with all at once (speed.md).
"""

from types import SimpleNamespace
from typing import Any, no_type_check

import warp as wp

from warp_caustics.kernels.collimated import collimated_functions
from warp_caustics.kernels.effects import PLAIN, Effects
from warp_caustics.kernels.fused import GPU_OPTIONS
from warp_caustics.kernels.general import general_functions
from warp_caustics.kernels.made_once import made_once
from warp_caustics.kernels.native import lanes_adder
from warp_caustics.kernels.photons import bench_functions, photons_struct
from warp_caustics.kernels.pixels import gathering_function
from warp_caustics.kernels.surface import photon_function, photon_struct
from warp_caustics.kernels.wide import wide_functions


@made_once
def fused_adjoint_kernels(
    dtype: Any,
    profile: str,
    is_lattice: bool,
    lanes: int,
    defers: bool,
    effects: Effects = PLAIN,
    in_order: bool = False,
    by_wavelength: bool = False,
) -> SimpleNamespace:
    """Kernels ``splat_photons_adjoint`` and ``splat_deferred_adjoint``.

    Args:
        dtype: wp.float32 or wp.float64.
        profile: shape of the footprint, one of ``PROFILES``.
        is_lattice: photons lie on a grid (positions are its axes) instead of anywhere.
        lanes: threads that share a footprint's columns; 1 for compact ones, several for wide ones on a GPU.
        defers: wide footprints are put on a list, for the ``deferred`` kernel of a variant with many lanes.
        effects: beyond refraction.
        in_order: the same sums every time: photons are listed with all of their wavelengths instead of footprints, so
            that no two groups of threads add to one photon, and the ``deferred`` kernel has ``WARP_LANES`` on a GPU.
        by_wavelength: a thread for each wavelength of a photon, which add to one gradient: a launch of few photons
            waits for those with large footprints at all of them. For one lane, not in order.
    """
    # GPU variants have several lanes or leave wide footprints to those that have.
    in_registers = lanes == 1 and not defers
    options = {} if in_registers else GPU_OPTIONS
    gather = gathering_function(dtype, profile, lanes, in_registers)
    is_straight = effects.is_straight
    collimated, general = collimated_functions(dtype, effects), general_functions(dtype, effects)
    light = collimated if is_straight else general
    refraction, footprint = light.refraction, light.footprint
    footprint_adjoint, record_gradient, weighted = (
        collimated.footprint_adjoint,
        general.record_gradient,
        general.weighted,
    )
    bench = bench_functions(dtype, effects)
    optics_of, colour_of = bench.optics_of, bench.colour_of
    add_over_lanes = lanes_adder(dtype)
    wide = wide_functions(dtype, profile, False)
    covered_pixels, put_off = wide.covered_pixels, wide.put_off
    photon_at = photon_function(dtype, is_lattice)
    Photon, Photons = photon_struct(dtype), photons_struct(dtype)
    vec6 = wp.types.vector(length=6, dtype=dtype)
    zero = wp.constant(dtype(0.0))
    is_blocked = effects.second_hits

    @no_type_check
    @wp.func
    def gather_photon(
        photon: Photon,
        c: wp.int32,
        item: wp.int32,
        photons: Photons,
        b: wp.int32,
        p: wp.int32,
        lane: wp.int32,
        grad_image: wp.array4d[dtype],
        listed: wp.array2d[wp.int32],
        count: wp.array[wp.int32],
    ):
        """Gradient of the surface maps [6] from one wavelength, and whether it is; zero if it is left to the list."""
        gradient = vec6()
        here = True
        optics = optics_of(photons, b)
        colour = colour_of(photons, b, c)
        bent = refraction(photon, colour, optics)
        f = footprint(photon, colour, bent, optics)
        if wp.static(is_blocked):
            if photons.clear[b, c, p] == wp.uint8(0):
                f.amplitude = zero
        if f.amplitude != zero:
            if wp.static(defers):
                if covered_pixels(f.sigma_x, f.sigma_y) > photons.optics.wide_pixels:
                    here = False
                    if wp.static(not in_order):
                        put_off(item, 0, 0, lane, listed, count)
            if here:
                g = gather(f, b, c, lane, grad_image)
                if wp.static(is_straight):
                    gradient = footprint_adjoint(photon, colour, bent, optics, f, g)
                else:
                    gradient, _x, _y, _colour, _optics, _g = wp.grad(weighted)(
                        photon.maps, photon.x, photon.y, colour, optics, record_gradient(bent, f, g)
                    )
        return gradient, here

    @no_type_check
    @wp.kernel(enable_backward=False, module="unique", module_options=options)
    def splat_photons_adjoint(
        coefficients: wp.array3d[dtype],
        photons: Photons,
        grad_image: wp.array4d[dtype],
        # outputs
        grad_maps: wp.array3d[dtype],
        listed: wp.array2d[wp.int32],
        count: wp.array[wp.int32],
    ):
        """Gradient with respect to the surface maps [B, 6, N]; with several threads a photon it is added to zeros.

        Launched for [B, N, lanes], or for [B, C, N] by wavelength.
        """
        b, p, lane = wp.tid()
        channels = grad_image.shape[1]
        first_channel = wp.int32(0)
        last_channel = channels - 1
        if wp.static(by_wavelength):
            first_channel = p
            last_channel = p
            p = lane
            lane = wp.int32(0)
        photon = photon_at(coefficients, photons, b, p)
        item = (b * photons.count + p) * channels
        gradient = vec6()
        left = wp.int32(0)
        for c in range(first_channel, last_channel + 1):
            if left == 0:
                found, here = gather_photon(photon, c, item + c, photons, b, p, lane, grad_image, listed, count)
                gradient += found
                if wp.static(in_order):
                    left += wp.where(here, 0, 1)
        if wp.static(in_order):
            if left > 0:
                gradient = vec6()
                put_off(b * photons.count + p, 0, 0, lane, listed, count)
        for plane in range(6):
            if wp.static(lanes == 1 and not by_wavelength):
                grad_maps[b, plane, p] = gradient[plane]
            else:
                wp.atomic_add(grad_maps, b, plane, p, gradient[plane])

    @no_type_check
    @wp.kernel(enable_backward=False, module="unique", module_options=options)
    def splat_deferred_adjoint(
        coefficients: wp.array3d[dtype],
        photons: Photons,
        grad_image: wp.array4d[dtype],
        groups: wp.int32,
        listed: wp.array2d[wp.int32],
        count: wp.array[wp.int32],
        # outputs
        grad_maps: wp.array3d[dtype],
    ):
        """Adds what the footprints on the list contribute to the gradient."""
        group, lane = wp.tid()
        channels = grad_image.shape[1]
        for entry in range(group, count[0], groups):
            c = listed[entry, 0] % channels
            item = listed[entry, 0] // channels
            if wp.static(in_order):
                item = listed[entry, 0]
            b = item // photons.count
            p = item - b * photons.count
            photon = photon_at(coefficients, photons, b, p)
            if wp.static(in_order):
                total = vec6()
                for channel in range(channels):
                    found, _h = gather_photon(photon, channel, 0, photons, b, p, lane, grad_image, listed, count)
                    total += found
                add_over_lanes(grad_maps, b, p, total, lane)
            else:
                gradient, _here = gather_photon(photon, c, 0, photons, b, p, lane, grad_image, listed, count)
                for plane in range(6):
                    wp.atomic_add(grad_maps, b, plane, p, gradient[plane])

    return SimpleNamespace(splat_photons_adjoint=splat_photons_adjoint, splat_deferred_adjoint=splat_deferred_adjoint)
