"""Light inside the glass that meets the relief a second time: found by marching along its way.

A steep flank bends light uphill, into the ridge, and where the ridge is narrow the light meets its other flank before
it is below it. With the depth s below the starting point, at (x, y) + G s and the height h0 - s, light is in the glass
while

    F(s) = h((x, y) + G s) - (h0 - s) >= 0,    G = -t_xy / t_z.

F starts at 0 and rises. It cannot fall faster than L |G| - 1 per depth, L being the steepest slope of the relief, so a
step of F / (L |G| - 1) meets no root that it could miss. Where that is less than a sixteenth of a sample, so much is
stepped, and a least value between two steps is looked at where F' = grad h . G + 1 turns from falling to rising. Light
with L |G| <= 1, nearly all of it, needs no step, and below the lowest point of the relief there is nothing left to
meet. Lowest and steepest follow from the coefficients, between which the spline and its slopes lie.

Whether a path meets the relief again jumps from no to yes: it has no derivative, and none is made up. Not looked for:
what becomes of the light afterwards, and shadows that slanting light casts before it enters the glass.
"""

from typing import Any, no_type_check

import warp as wp

from warp_caustics.kernels.effects import Effects
from warp_caustics.kernels.made_once import made_once
from warp_caustics.kernels.path import path_functions
from warp_caustics.kernels.photons import bench_functions, colour_struct, optics_struct, photons_struct
from warp_caustics.kernels.surface import photon_function, surface_functions

LEAST_STEP = 1.0 / 16.0
"""Shortest step sideways [samples]."""

SHALLOWEST = 1.0e-5
"""Light that comes out of the relief by less than this [samples] has not met it: rounding of float32."""

MAX_STEPS = 2**16
"""No plate has so many samples and steps in a row."""


@made_once
def march_function(dtype: Any, effects: Effects) -> Any:
    """``clear_path``: 1 for a path that does not meet the relief again, else 0; found by marching."""
    Photons, Optics, Colour = photons_struct(dtype), optics_struct(dtype), colour_struct(dtype)
    paths = path_functions(dtype, effects)
    incidence, refracted_slope = paths.incidence, paths.refracted_slope
    surface_at = surface_functions(dtype).surface_at
    vec3 = wp.types.vector(length=3, dtype=dtype)
    zero = wp.constant(dtype(0.0))
    one = wp.constant(dtype(1.0))
    least_step = wp.constant(dtype(LEAST_STEP))
    shallowest = wp.constant(dtype(SHALLOWEST))

    @no_type_check
    @wp.func
    def clear_path(
        coefficients: wp.array3d[dtype],
        photons: Photons,
        b: wp.int32,
        x0: dtype,
        y0: dtype,
        h: dtype,
        h_x: dtype,
        h_y: dtype,
        colour: Colour,
        optics: Optics,
        lowest: dtype,
        steepest: dtype,
    ):
        """Of the path from (x0, y0) [m], where the relief has this height [m] and these slopes, and its bounds."""
        w, _ = incidence(x0, y0, h, optics)
        t, _ = refracted_slope(w, vec3(-h_x, -h_y, one), colour.eta, colour.ratio)
        # --- sideways per depth [1], and how fast the relief can come nearer [1]
        side_x = -t[0] / t[2]
        side_y = -t[1] / t[2]
        side = wp.sqrt(side_x * side_x + side_y * side_y)
        nearing = steepest * side - one
        found = wp.uint8(1)
        if nearing > zero:
            pitch = one / wp.max(photons.samples_per_m_x, photons.samples_per_m_y)
            least = least_step * pitch / side
            # --- how deep there is relief to meet: down to its lowest, or to the side of the plate
            end = h - lowest
            if side_x != zero:
                end = wp.min(end, (optics.half_x - x0 * wp.sign(side_x)) / wp.abs(side_x))
            if side_y != zero:
                end = wp.min(end, (optics.half_y - y0 * wp.sign(side_y)) / wp.abs(side_y))
            depth = zero
            before = zero
            falling = zero
            step = least
            for _step in range(wp.static(MAX_STEPS)):
                if depth >= end:
                    break
                depth = wp.min(depth + step, end)
                maps = surface_at(coefficients, b, x0 + side_x * depth, y0 + side_y * depth, photons)
                glass = maps[0] - (h - depth)
                rising = maps[1] * side_x + maps[2] * side_y + one
                if falling < zero and rising > zero and glass > zero:
                    # --- a least value between both: where F' is 0 on the chord
                    between = before + (depth - before) * falling / (falling - rising)
                    lower = surface_at(coefficients, b, x0 + side_x * between, y0 + side_y * between, photons)
                    glass = wp.min(glass, lower[0] - (h - between))
                if glass < -shallowest * pitch:
                    found = wp.uint8(0)
                    break
                before = depth
                falling = rising
                step = wp.max(glass / nearing, least)
        return found

    return clear_path


@made_once
def second_hits_kernel(dtype: Any, is_lattice: bool, effects: Effects) -> Any:
    """Kernel ``find_clear``: which paths go from the relief to the bottom face without meeting the relief again."""
    Photons = photons_struct(dtype)
    photon_at = photon_function(dtype, is_lattice)
    bench = bench_functions(dtype, effects)
    optics_of, colour_of = bench.optics_of, bench.colour_of
    clear_path = march_function(dtype, effects)

    @no_type_check
    @wp.kernel(enable_backward=False, module="unique")
    def find_clear(
        coefficients: wp.array3d[dtype],
        photons: Photons,
        bounds: wp.array2d[dtype],
        # outputs
        clear: wp.array3d[wp.uint8],
    ):
        """1 for clear paths [B, C, N], else 0; spline coefficients [B, n + 4, n + 4] and ``bounds_of`` them [B, 2]."""
        b, p = wp.tid()
        optics = optics_of(photons, b)
        photon = photon_at(coefficients, photons, b, p)
        for c in range(clear.shape[1]):
            clear[b, c, p] = clear_path(
                coefficients,
                photons,
                b,
                photon.x,
                photon.y,
                photon.maps[0],
                photon.maps[1],
                photon.maps[2],
                colour_of(photons, b, c),
                optics,
                bounds[b, 0],
                bounds[b, 1],
            )

    return find_clear
