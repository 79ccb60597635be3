"""Adjoint of ``fused_splat.py``, written by hand: from the image gradient to that of the surface maps.

Every photon repeats its forward pass, takes the moments of the image gradient under its footprints, and goes
back through covariance, Jacobian and refraction. It reads the image and writes its own six numbers: no atomics, and the
same result every time, unless several threads share a footprint.
"""

from functools import cache
from types import SimpleNamespace
from typing import Any, no_type_check

import warp as wp

from warp_caustics.kernels.collimated import collimated_functions
from warp_caustics.kernels.splat import PROFILE_FACTORIES, cpu_row_functions, window_functions
from warp_caustics.kernels.surface import surface_functions
from warp_caustics.kernels.trace import optics_struct


@cache
def fused_adjoint_kernels(dtype: Any, profile: str, lanes: int, is_lattice: bool, defers: bool) -> SimpleNamespace:
    """Kernels ``splat_photons_adjoint`` and ``splat_deferred_adjoint``.

    Args:
        dtype: wp.float32 or wp.float64.
        profile: shape of the footprint, one of ``PROFILES``.
        lanes: threads that share a footprint's columns; 1 for compact ones, several for wide ones on a GPU.
        is_lattice: photons lie on a grid (positions are its axes) instead of anywhere.
        defers: wide footprints are put on a list, for the ``deferred`` kernel of a variant with many lanes.
    """
    cumulative, density = PROFILE_FACTORIES[profile](dtype)
    surface_at = surface_functions(dtype).surface_at
    functions = collimated_functions(dtype, profile, is_lattice)
    refraction, footprint, footprint_adjoint = functions.refraction, functions.footprint, functions.footprint_adjoint
    place, defer = functions.place, functions.defer
    first_pixel, last_pixel = window_functions(dtype, profile)
    Optics = optics_struct(dtype)
    half = wp.constant(dtype(0.5))
    one = wp.constant(dtype(1.0))
    zero = wp.constant(dtype(0.0))
    vec5 = wp.types.vector(length=5, dtype=dtype)
    vec6 = wp.types.vector(length=6, dtype=dtype)
    one_lane = lanes == 1
    # GPU variants have several lanes or leave wide footprints to those that have.
    on_cpu = profile == "spline" and one_lane and not defers
    _, gather_row = cpu_row_functions(dtype)

    @no_type_check
    @wp.func
    def gather_photon(
        b: wp.int32,
        p: wp.int32,
        first_channel: wp.int32,
        end_channel: wp.int32,
        lane: wp.int32,
        coefficients: wp.array3d[dtype],
        positions: wp.array2d[dtype],
        photons: wp.int32,
        columns: wp.int32,
        samples_per_m_x: dtype,
        samples_per_m_y: dtype,
        n: wp.int32,
        eta: wp.array[dtype],
        ratio: wp.array[dtype],
        radiosity: wp.array[dtype],
        optics: Optics,
        grad_image: wp.array4d[dtype],
        deferred: wp.array[wp.int32],
        deferred_count: wp.array[wp.int32],
    ):
        """Gradient of photon p's surface maps in some channels, vec6; wide footprints are put off if asked for."""
        x, y = place(positions, p, columns)
        maps = surface_at(coefficients, b, x, y, samples_per_m_x, samples_per_m_y, n)
        gradient = vec6()
        for c in range(first_channel, end_channel):
            slopes = refraction(maps, eta[c], ratio[c])
            f = footprint(x, y, maps, slopes, radiosity[c], optics)
            if f[5] != zero:
                column = f[0]
                row = f[1]
                sigma_x = f[2]
                sigma_y = f[3]
                beta = f[4]
                inv_x = one / sigma_x
                inv_y = one / sigma_y
                here = True
                if wp.static(defers):
                    here = not defer(
                        b, p, c, lane, photons, grad_image.shape[1], sigma_x, sigma_y, optics, deferred, deferred_count
                    )
                if here:
                    # Adjoint of the pixels: moments of the image gradient under the footprint.
                    g_column = zero
                    g_row = zero
                    g_sigma_x = zero
                    g_sigma_y = zero
                    g_beta = zero
                    first_row = first_pixel(row, sigma_y)
                    t_below = (dtype(first_row) - row) * inv_y
                    below = cumulative(t_below)
                    below_density = density(t_below)
                    for i in range(first_row, last_pixel(row, sigma_y, grad_image.shape[2]) + 1):
                        t_above = (dtype(i + 1) - row) * inv_y
                        above = cumulative(t_above)
                        above_density = density(t_above)
                        offset = dtype(i) + half - row
                        centre = column + beta * offset
                        row_sum = zero
                        row_slope = zero
                        row_width = zero
                        first_column = first_pixel(centre, sigma_x)
                        last_column = last_pixel(centre, sigma_x, grad_image.shape[3])
                        if wp.static(on_cpu):
                            sums = gather_row(grad_image, b, c, i, first_column, last_column, centre, inv_x)
                            row_sum = sums[0]
                            row_slope = sums[1]
                            row_width = sums[2]
                        else:
                            # Each lane takes a run of neighbouring columns, so that edges are evaluated once.
                            run = (last_column - first_column + wp.static(lanes)) // wp.static(lanes)
                            first_column += lane * run
                            last_column = wp.min(last_column, first_column + run - 1)
                            t_left = (dtype(first_column) - centre) * inv_x
                            left = cumulative(t_left)
                            left_density = density(t_left)
                            for j in range(first_column, last_column + 1):
                                t_right = (dtype(j + 1) - centre) * inv_x
                                right = cumulative(t_right)
                                right_density = density(t_right)
                                g = grad_image[b, c, i, j]
                                row_sum += g * (right - left)
                                row_slope += g * (right_density - left_density)
                                row_width += g * (t_right * right_density - t_left * left_density)
                                t_left = t_right
                                left = right
                                left_density = right_density
                        share = above - below
                        g_centre = -share * row_slope * inv_x
                        g_sigma_x -= share * row_width * inv_x
                        g_column += g_centre
                        g_beta += g_centre * offset
                        g_row -= (above_density - below_density) * inv_y * row_sum + beta * g_centre
                        g_sigma_y -= (t_above * above_density - t_below * below_density) * inv_y * row_sum
                        t_below = t_above
                        below = above
                        below_density = above_density
                    moments = vec5(g_column, g_row, g_sigma_x, g_sigma_y, g_beta)
                    gradient += footprint_adjoint(
                        x, y, maps, eta[c], slopes, radiosity[c], optics, beta, inv_x, inv_y, moments
                    )
        return gradient

    @no_type_check
    @wp.kernel(enable_backward=False, module="unique")
    def splat_photons_adjoint(
        coefficients: wp.array3d[dtype],
        positions: wp.array2d[dtype],
        photons: wp.int32,
        columns: wp.int32,
        samples_per_m_x: dtype,
        samples_per_m_y: dtype,
        n: wp.int32,
        eta: wp.array[dtype],
        ratio: wp.array[dtype],
        radiosity: wp.array[dtype],
        optics: Optics,
        grad_image: wp.array4d[dtype],
        # outputs
        grad_maps: wp.array3d[dtype],
        deferred: wp.array[wp.int32],
        deferred_count: wp.array[wp.int32],
    ):
        """Gradient with respect to the surface maps [B, 6, N]; with several lanes it is added to zeros."""
        b, p, lane = wp.tid()
        gradient = gather_photon(
            b,
            p,
            0,
            grad_image.shape[1],
            lane,
            coefficients,
            positions,
            photons,
            columns,
            samples_per_m_x,
            samples_per_m_y,
            n,
            eta,
            ratio,
            radiosity,
            optics,
            grad_image,
            deferred,
            deferred_count,
        )
        for plane in range(6):
            if wp.static(one_lane):
                grad_maps[b, plane, p] = gradient[plane]
            else:
                wp.atomic_add(grad_maps, b, plane, p, gradient[plane])

    @no_type_check
    @wp.kernel(enable_backward=False, module="unique")
    def splat_deferred_adjoint(
        coefficients: wp.array3d[dtype],
        positions: wp.array2d[dtype],
        photons: wp.int32,
        columns: wp.int32,
        samples_per_m_x: dtype,
        samples_per_m_y: dtype,
        n: wp.int32,
        eta: wp.array[dtype],
        ratio: wp.array[dtype],
        radiosity: wp.array[dtype],
        optics: Optics,
        grad_image: wp.array4d[dtype],
        groups: wp.int32,
        deferred: wp.array[wp.int32],
        deferred_count: wp.array[wp.int32],
        # outputs
        grad_maps: wp.array3d[dtype],
    ):
        """Adds what the footprints on the list contribute to the gradient."""
        group, lane = wp.tid()
        channels = grad_image.shape[1]
        for item in range(group, deferred_count[0], groups):
            c = deferred[item] % channels
            photon = deferred[item] // channels
            b = photon // photons
            p = photon - b * photons
            gradient = gather_photon(
                b,
                p,
                c,
                c + 1,
                lane,
                coefficients,
                positions,
                photons,
                columns,
                samples_per_m_x,
                samples_per_m_y,
                n,
                eta,
                ratio,
                radiosity,
                optics,
                grad_image,
                deferred,
                deferred_count,
            )
            for plane in range(6):
                wp.atomic_add(grad_maps, b, plane, p, gradient[plane])

    return SimpleNamespace(splat_photons_adjoint=splat_photons_adjoint, splat_deferred_adjoint=splat_deferred_adjoint)
