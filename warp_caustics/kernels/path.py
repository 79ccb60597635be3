"""Where a light path comes from, and how it goes on inside the glass: what every file that follows one shares."""

from types import SimpleNamespace
from typing import Any, no_type_check

import warp as wp

from warp_caustics.kernels.effects import Effects
from warp_caustics.kernels.made_once import made_once
from warp_caustics.kernels.photons import optics_struct


@made_once
def path_functions(dtype: Any, effects: Effects) -> SimpleNamespace:
    """Warp functions for float32 or float64: ``incidence`` and ``refracted_slope``."""
    vec3 = wp.types.vector(length=3, dtype=dtype)
    Optics = optics_struct(dtype)
    has_tilt, has_point = effects.tilt, effects.point
    zero = wp.constant(dtype(0.0))
    one = wp.constant(dtype(1.0))

    @no_type_check
    @wp.func
    def incidence(x: dtype, y: dtype, h: dtype, optics: Optics):
        """Unit direction of the light at a point of the relief, and its distance from the source [m]."""
        w = vec3(zero, zero, -one)
        distance = one
        if wp.static(has_tilt):
            w = optics.tilt
        if wp.static(has_point):
            to_point = vec3(x - optics.light_x, y - optics.light_y, optics.base + h - optics.light_z)
            distance = wp.sqrt(wp.dot(to_point, to_point))
            w = to_point / distance
        return w, distance

    @no_type_check
    @wp.func
    def refracted_slope(w: vec3, m: vec3, eta: dtype, ratio: dtype):
        """Direction inside the glass (x, y, z) and squared cosine behind the bottom face.

        w: unit direction of incidence; m: surface normal (-h_x, -h_y, 1), not normalised;
        eta: 1 / n; ratio: n / n_exit. Snell's law as t = eta w + gamma m with |t| = 1.
        """
        wm = wp.dot(w, m)
        mm = wp.dot(m, m)
        root = wp.sqrt(eta * eta * wm * wm + (one - eta * eta) * mm)
        gamma = -(eta * wm + root) / mm
        t = eta * w + gamma * m
        q = one - ratio * ratio * (t[0] * t[0] + t[1] * t[1])
        return t, q

    return SimpleNamespace(incidence=incidence, refracted_slope=refracted_slope)
