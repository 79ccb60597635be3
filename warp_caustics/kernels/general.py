"""Refraction of light paths through the plate, with their photon differentials, for light from anywhere.

A path starts at (x, y) on the relief, z = d + h(x, y), is refracted into the
glass, crosses to the flat bottom face z = 0, is refracted into the exit medium
and meets the screen. All derivatives of the screen position with respect to
(x, y) are carried along by the product rule, so that the footprint's
covariance sigma0^2 J J^T uses the exact Jacobian J of the map plate -> screen
(photon differentials: Igehy 1999; Frisvad et al., CGF 33(6), 252 (2014)).

Light ends at the edge of the plate: the footprints of a photon lattice are
squeezed where they would reach over it. Otherwise the image's border would be
too dark, and a reconstruction bend the whole plate to brighten it.

Paths that meet the relief again are told by ``second_hits.py``. Not modelled: shadows that one part of the relief
throws on another.

The adjoint is Warp's, of functions without loops. ``collimated.py`` has the short form for light from straight above,
``row_general.py`` one for vectors with an adjoint by hand.
"""

from types import SimpleNamespace
from typing import Any, no_type_check

import warp as wp

from warp_caustics.kernels.effects import Effects
from warp_caustics.kernels.footprint import footprint_functions, footprint_struct
from warp_caustics.kernels.fresnel import fresnel_functions
from warp_caustics.kernels.made_once import made_once
from warp_caustics.kernels.path import path_functions
from warp_caustics.kernels.photons import colour_struct, optics_struct
from warp_caustics.kernels.surface import photon_struct

GRAZING = 1.0e-6
"""Below this squared cosine the exit angle is within 0.06 degrees of grazing: counted as totally reflected,
because the differentials grow as its power -3/2."""

FAR_PX = 1.0e6
"""Position [px] given to paths without a footprint: finite, and beyond every window."""


@made_once
def general_functions(dtype: Any, effects: Effects) -> SimpleNamespace:
    """Warp functions for float32 or float64 and some effects.

    ``lit_area``, ``passed`` and ``landing`` are steps of a path and ``record`` is all of it; ``refraction`` and
    ``footprint`` are as those of ``collimated.py``. Their adjoint is Warp's of ``weighted``, by ``record_gradient``; it
    must be taken where no other function is in between, since Warp puts functions that take one last.
    """
    has_fresnel, has_lamp, has_tilt, has_point = effects.fresnel, effects.lamp, effects.tilt, effects.point
    transmission = fresnel_functions(dtype).transmission
    paths = path_functions(dtype, effects)
    incidence, refracted_slope = paths.incidence, paths.refracted_slope
    vec2 = wp.types.vector(length=2, dtype=dtype)
    vec3 = wp.types.vector(length=3, dtype=dtype)
    vec6 = wp.types.vector(length=6, dtype=dtype)
    Optics = optics_struct(dtype)
    Colour = colour_struct(dtype)
    Photon = photon_struct(dtype)
    Footprint = footprint_struct(dtype, 0)
    functions = footprint_functions(dtype)
    plate_sigma, screen_covariance = functions.plate_sigma, functions.screen_covariance
    footprint_of, covariance_adjoint = functions.footprint_of, functions.covariance_adjoint
    zero = wp.constant(dtype(0.0))
    one = wp.constant(dtype(1.0))
    two = wp.constant(dtype(2.0))
    grazing = wp.constant(dtype(GRAZING))
    far = wp.constant(dtype(FAR_PX))

    @no_type_check
    @wp.func
    def refract_differential(w: vec3, dw: vec3, m: vec3, dm: vec3, eta: dtype):
        """Derivative of the direction inside the glass along one plate coordinate."""
        wm = wp.dot(w, m)
        mm = wp.dot(m, m)
        root = wp.sqrt(eta * eta * wm * wm + (one - eta * eta) * mm)
        gamma = -(eta * wm + root) / mm
        dwm = wp.dot(dw, m) + wp.dot(w, dm)
        dmm = two * wp.dot(m, dm)
        droot = (eta * eta * wm * dwm + (one - eta * eta) * dmm / two) / root
        dgamma = -(eta * dwm + droot + gamma * dmm) / mm
        return eta * dw + dgamma * m + gamma * dm

    @no_type_check
    @wp.func
    def shift_differential(h: dtype, dh: dtype, t: vec3, dt: vec3, q: dtype, ratio: dtype, base: dtype, gap: dtype):
        """Derivative along one plate coordinate of the sideways shift between relief and screen [1]."""
        g = vec2(-t[0] / t[2], -t[1] / t[2])
        dg = vec2((dt[0] + g[0] * dt[2]) / -t[2], (dt[1] + g[1] * dt[2]) / -t[2])
        # Exit slope f = s / sqrt(q), s = ratio (t_x, t_y), q = 1 - |s|^2.
        cosine = wp.sqrt(q)
        s = vec2(ratio * t[0], ratio * t[1])
        ds = vec2(ratio * dt[0], ratio * dt[1])
        df = ds / cosine + s * (wp.dot(s, ds) / (q * cosine))
        return dh * g + (base + h) * dg + gap * df

    @no_type_check
    @wp.func
    def lit_area(w: vec3, m: vec3, distance: dtype, optics: Optics):
        """Flux through the path's part of the plate for unit radiosity, over the pixel's area.

        Collimated: the area itself; slanting light, -w.m / -w_z of it, zero where it meets the back of a slope. Point
        source: radiant intensity D^2 (unit irradiance on the nominal top below the source, at distance D) times the
        solid angle -w.m dx dy / r^2, zero outside the cone.
        """
        area = optics.area
        if wp.static(has_tilt):
            area = optics.area * wp.max(wp.dot(w, m) / w[2], zero)
        if wp.static(has_point):
            area = zero
            facing = -wp.dot(w, m)
            if facing > zero and -w[2] >= optics.cos_cone:
                relative = optics.light_distance / distance
                area = optics.area * relative * relative * facing
        return area

    @no_type_check
    @wp.func
    def passed(w: vec3, m: vec3, t: vec3, q: dtype, eta: dtype, ratio: dtype, flat: dtype):
        """Share of the flux that both faces let through, relative to normal incidence over ``flat``."""
        share = one
        if wp.static(has_fresnel):
            share = transmission(-wp.dot(w, m), -wp.dot(t, m), eta) * transmission(-t[2], wp.sqrt(q), ratio) / flat
        return share

    @no_type_check
    @wp.func
    def lamp_differential(
        h: dtype, w: vec3, dw: vec3, m: vec3, t: vec3, q: dtype, eta: dtype, ratio: dtype, optics: Optics
    ):
        """Covariance (var_x, cov, var_y) [px^2] from a standard deviation dw of the direction of incidence."""
        none = vec3(zero, zero, zero)
        dt = refract_differential(w, dw, m, none, eta)
        shift = shift_differential(h, zero, t, dt, q, ratio, optics.base, optics.gap)
        x = shift[0] * optics.pixels_per_m_x
        y = shift[1] * optics.pixels_per_m_y
        return vec3(x * x, x * y, y * y)

    @no_type_check
    @wp.func
    def lamp_covariance(
        h: dtype, w: vec3, distance: dtype, m: vec3, t: vec3, q: dtype, eta: dtype, ratio: dtype, optics: Optics
    ):
        """Covariance that a lamp of finite size adds: a level disc for a point source, else one of directions."""
        sigma = wp.sqrt(optics.lamp_var)
        # Two directions across the light.
        flat = wp.sqrt(w[0] * w[0] + w[2] * w[2])
        first = vec3(-w[2] / flat, zero, w[0] / flat)
        second = wp.cross(w, first)
        if wp.static(has_point):
            first = (w * w[0] - vec3(one, zero, zero)) / distance
            second = (w * w[1] - vec3(zero, one, zero)) / distance
        return lamp_differential(h, w, sigma * first, m, t, q, eta, ratio, optics) + lamp_differential(
            h, w, sigma * second, m, t, q, eta, ratio, optics
        )

    @no_type_check
    @wp.func
    def landing(x: dtype, y: dtype, h: dtype, t: vec3, q: dtype, ratio: dtype, optics: Optics):
        """Where a path meets the screen, in pixels from the window's lower corner (column, row)."""
        f = ratio / wp.sqrt(q)
        thickness = optics.base + h
        screen_x = x - thickness * t[0] / t[2] + optics.gap * f * t[0]
        screen_y = y - thickness * t[1] / t[2] + optics.gap * f * t[1]
        return vec2(
            (screen_x - optics.window_x) * optics.pixels_per_m_x,
            (screen_y - optics.window_y) * optics.pixels_per_m_y,
        )

    @no_type_check
    @wp.func
    def record(maps: vec6, x: dtype, y: dtype, colour: Colour, optics: Optics):
        """Footprint record (RECORD_NAMES) of a path from (x, y) [m] on the relief; amplitude 0 if no light lands."""
        h = maps[0]
        h_x = maps[1]
        h_y = maps[2]
        eta = colour.eta
        ratio = colour.ratio
        # --- refraction at the relief: directions w, t and normal m (vec3), flux of the path over the pixel's area
        w, distance = incidence(x, y, h, optics)
        m = vec3(-h_x, -h_y, one)
        t, q = refracted_slope(w, m, eta, ratio)
        lit = lit_area(w, m, distance, optics)
        found = vec6(far, far, optics.min_var, zero, optics.min_var, zero)
        if q > grazing and lit > zero:
            # --- differentials of incidence [1/m], refraction [1/m] and shift to the screen [1], along x and y
            dw_x = vec3(zero, zero, zero)
            dw_y = vec3(zero, zero, zero)
            if wp.static(has_point):
                dp_x = vec3(one, zero, h_x)
                dp_y = vec3(zero, one, h_y)
                dw_x = (dp_x - w * wp.dot(w, dp_x)) / distance
                dw_y = (dp_y - w * wp.dot(w, dp_y)) / distance
            dt_x = refract_differential(w, dw_x, m, vec3(-maps[3], -maps[4], zero), eta)
            dt_y = refract_differential(w, dw_y, m, vec3(-maps[4], -maps[5], zero), eta)
            shift_x = shift_differential(h, h_x, t, dt_x, q, ratio, optics.base, optics.gap)
            shift_y = shift_differential(h, h_y, t, dt_y, q, ratio, optics.base, optics.gap)
            # --- footprint: columns of J in its standard deviations and pixels, covariance [px^2]
            sigma_x = plate_sigma(x, optics.half_x, optics)
            sigma_y = plate_sigma(y, optics.half_y, optics)
            ux = (one + shift_x[0]) * sigma_x * optics.pixels_per_m_x
            uy = shift_x[1] * sigma_x * optics.pixels_per_m_y
            vx = shift_y[0] * sigma_y * optics.pixels_per_m_x
            vy = (one + shift_y[1]) * sigma_y * optics.pixels_per_m_y
            raw = vec3(ux * ux + vx * vx, ux * uy + vx * vy, uy * uy + vy * vy)
            if wp.static(has_lamp):
                raw += lamp_covariance(h, w, distance, m, t, q, eta, ratio, optics)
            covariance = screen_covariance(raw, optics)
            # --- where it lands [px]
            centre = landing(x, y, h, t, q, ratio, optics)
            finite = wp.isfinite(centre[0]) and wp.isfinite(centre[1]) and wp.isfinite(raw[0] + raw[2])
            if finite and wp.abs(centre[0]) < far and wp.abs(centre[1]) < far:
                amplitude = lit * colour.radiosity * passed(w, m, t, q, eta, ratio, colour.flat_share)
                found = vec6(centre[0], centre[1], covariance[0], covariance[1], covariance[2], amplitude)
        return found

    @no_type_check
    @wp.func
    def weighted(maps: vec6, x: dtype, y: dtype, colour: Colour, optics: Optics, weights: vec6):
        """Weights times the record: one number, whose gradient by the maps is Warp's."""
        return wp.dot(weights, record(maps, x, y, colour, optics))

    @no_type_check
    @wp.func
    def refraction(photon: Photon, colour: Colour, optics: Optics):
        """What ``footprint`` and its adjoint both need: the record."""
        return record(photon.maps, photon.x, photon.y, colour, optics)

    @no_type_check
    @wp.func
    def footprint(photon: Photon, colour: Colour, bent: vec6, optics: Optics):
        """Footprint of a photon at one wavelength; amplitude 0 if no light lands."""
        return footprint_of(bent[0], bent[1], vec3(bent[2], bent[3], bent[4]), bent[5])

    @no_type_check
    @wp.func
    def record_gradient(bent: vec6, f: Footprint, g: Footprint):
        """Gradient of the record from that of a footprint with light; ``g`` is for unit amplitude."""
        c = f.amplitude * covariance_adjoint(f, bent[4], g)
        return vec6(f.amplitude * g.column, f.amplitude * g.row, c[0], c[1], c[2], g.amplitude)

    # Warp gives functions the adjoints that ``wp.grad`` needs where it meets them below one first; here plain calls
    # come before. Gradients would be zero, without a word.
    for function in (
        *(incidence, refracted_slope, transmission, plate_sigma, screen_covariance, refract_differential),
        *(shift_differential, lit_area, passed, lamp_differential, lamp_covariance, landing, record, weighted),
    ):
        function.adj.force_adjoint_codegen = True

    return SimpleNamespace(
        lit_area=lit_area,
        passed=passed,
        landing=landing,
        record=record,
        refraction=refraction,
        footprint=footprint,
        record_gradient=record_gradient,
        weighted=weighted,
    )
