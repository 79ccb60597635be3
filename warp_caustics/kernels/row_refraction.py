"""Refraction of light from straight above for a row or a block of photons, sixteen at a time, on a CPU.

The formulas and names are those of ``collimated.py``, ``footprint.py``, ``fresnel.py`` and ``lamp.py``, where they are
explained; light from elsewhere is left to ``general.py``.
"""

from functools import cache
from typing import Any, no_type_check

import warp as wp

from warp_caustics.kernels.footprint import BOX_VARIANCE
from warp_caustics.kernels.general import FAR_PX, GRAZING
from warp_caustics.kernels.photons import colour_struct, optics_struct
from warp_caustics.kernels.vectors import vector_snippet

FOOTPRINT_PLANE, GRADIENT_PLANE, MAP_GRADIENT_PLANE, PLANES = 6, 12, 18, 24
"""Scratch memory of a row: surface maps (MAP_NAMES), footprints (members of ``footprint_struct``), their gradient for
unit amplitude in the same order, and the gradient of the maps."""

_PER_ROW = f"""
    const size_t plane = work.shape[1];
    const real eta = colour.eta, ratio = colour.ratio, c = real(1) - eta * eta;
    const bool is_squeezed = optics.squeeze > real(0);
    const real inv_squeeze = is_squeezed ? real(1) / optics.squeeze : real(0);
    const real px_x = optics.pixels_per_m_x, px_y = optics.pixels_per_m_y;
    const real box = real({BOX_VARIANCE!r}), grazing = real({GRAZING!r}), far = real({FAR_PX!r});
"""

_ROW_Y = """
    const real from_edge_y = (optics.half_y - (row_y < real(0) ? -row_y : row_y)) * inv_squeeze;
    const real y = row_y, sigma_of_y = is_squeezed && from_edge_y < optics.sigma0 ? from_edge_y : optics.sigma0;
"""

_PHOTON_Y = """
        const V y = load(across.data + 2 * across.shape[1] + j);
        V sigma_of_y = optics.sigma0;
        if (is_squeezed) sigma_of_y = smaller(sigma_of_y, (optics.half_y - __builtin_elementwise_abs(y)) * inv_squeeze);
"""

_PER_PHOTON = """
        PHOTON_Y
        const V x = load(across.data + across.shape[1] + j);
        const V h_x = load(at + plane), h_y = load(at + 2 * plane);
        const V h_xx = load(at + 3 * plane), h_xy = load(at + 4 * plane), h_yy = load(at + 5 * plane);
        const V thickness = optics.base + load(at);
        const V slope2 = h_x * h_x + h_y * h_y;
        const V m = one + slope2;
        // --- inside the glass
        const V root = root_of(eta * eta + c * m);
        const V inv_root = one / root;
        const V k = c / (one + eta * root);
        const V k_m = real(-0.5) * k * k * eta * inv_root;
        // --- behind the bottom face
        const V bend = c / (root + eta);
        const V u = ratio * bend;
        const V u1 = real(-0.5) * u * bend * inv_root;
        const V s1 = real(2) * u * u1 * slope2 + u * u;
        const V cosine2 = one - u * u * slope2;
        const V z = one / root_of(larger(cosine2, V(grazing)));
        const V z1 = real(0.5) * s1 * z * z * z;
        const V e = u * z, e_m = u1 * z + u * z1;
        // --- shift and Jacobian
        const V shift = thickness * k + optics.gap * e;
        const V shift_m = real(2) * (thickness * k_m + optics.gap * e_m);
        const V v_x = h_x * h_xx + h_y * h_xy, v_y = h_x * h_xy + h_y * h_yy;
        const V w_x = k * h_x + shift_m * v_x, w_y = k * h_y + shift_m * v_y;
        V sigma_of_x = optics.sigma0;
        if (is_squeezed) sigma_of_x = smaller(sigma_of_x, (optics.half_x - __builtin_elementwise_abs(x)) * inv_squeeze);
        const V unit_xx = sigma_of_x * px_x, unit_yx = sigma_of_x * px_y;
        const auto unit_xy = sigma_of_y * px_x, unit_yy = sigma_of_y * px_y;
        const V j_xx = (one + shift * h_xx + h_x * w_x) * unit_xx;
        const V j_xy = (shift * h_xy + h_x * w_y) * unit_xy;
        const V j_yx = (shift * h_xy + h_y * w_x) * unit_yx;
        const V j_yy = (one + shift * h_yy + h_y * w_y) * unit_yy;
        V raw_x = j_xx * j_xx + j_xy * j_xy, raw_y = j_yx * j_yx + j_yy * j_yy;
        V raw_xy = j_xx * j_yx + j_xy * j_yy;
        LAMP_SIZE
        const V spread = larger(raw_x + raw_y, V(optics.min_var));
        const V shrink = smaller(one, optics.max_var / spread);
        const V var_y = shrink * raw_y + optics.min_var;
"""

_TRANSMISSION = """
    auto transmission = [&](V cos_in, V cos_out, real rho) __attribute__((always_inline)) -> V {
        const V s = rho * cos_in + cos_out, p = cos_in + rho * cos_out;
        return real(0.5) * (one + rho) * (one + rho) * cos_in * cos_out * (one / (s * s) + one / (p * p));
    };
    // derivatives of its logarithm by both cosines
    auto transmission_slopes = [&](V cos_in, V cos_out, real rho, V& by_in, V& by_out) __attribute__((always_inline)) {
        const V s = one / (rho * cos_in + cos_out), p = one / (cos_in + rho * cos_out);
        const V s3 = s * s * s, p3 = p * p * p, both = real(2) / (s * s + p * p);
        by_in = one / cos_in - both * (rho * s3 + p3);
        by_out = one / cos_out - both * (s3 + rho * p3);
    };
"""

_COSINES = """
        const V sine2 = bend * bend * slope2;
        const V cosine = root_of(one - sine2);
        const V cos_out = root_of(larger(one - ratio * ratio * sine2, V(grazing)));
"""

_PASSED = (
    _COSINES
    + """
        amount *= transmission(one, root, eta) * transmission(cosine, cos_out, ratio);
"""
)

_PASSED_ADJOINT = (
    _COSINES
    + """
        V by_one, by_root, by_cosine, by_out;
        transmission_slopes(one, root, eta, by_one, by_root);
        transmission_slopes(cosine, cos_out, ratio, by_cosine, by_out);
        const V through = by_cosine / cosine + by_out * ratio * ratio / cos_out;
        const V sine2_m = bend * bend * (one - bend * slope2 * inv_root);
        g_m += amplitude * load(g + 5 * plane) * (by_root * c * inv_root - through * sine2_m);
"""
)

_LAMP = """
        // --- lamp.py: J_dir = alpha I + turn grad h grad h^T
        const V part = eta / (eta + bend), tilt = bend * inv_root, side = one - tilt * slope2;
        const V e2 = u * u * z * z, by_e = e2 * side - tilt;
        const real behind = optics.gap * eta * ratio;
        const V alpha = thickness * part + behind * z;
        const V turned = behind * z * by_e - thickness * part * part * tilt;
        const V lamp_px = h_x * px_x, lamp_py = h_y * px_y;
        const V plain = optics.lamp_var * alpha * alpha;
        const V along = optics.lamp_var * turned * (real(2) * alpha + turned * slope2);
        raw_x += plain * px_x * px_x + along * lamp_px * lamp_px;
        raw_xy += along * lamp_px * lamp_py;
        raw_y += plain * px_y * px_y + along * lamp_py * lamp_py;
"""

_LAMP_ADJOINT = """
        const V part_m = real(0.5) * part * part * bend * tilt / eta;
        const V tilt_m = real(-0.5) * tilt * (tilt + c * inv_root * inv_root);
        const V side_m = -tilt_m * slope2 - tilt;
        const V z_m = real(0.5) * u * u * side * z * z * z;
        const V e2_m = real(2) * e2 * (z_m / z - real(0.5) * tilt);
        const V by_e_m = e2_m * side + e2 * side_m - tilt_m;
        const V alpha_m = thickness * part_m + behind * z_m;
        const V turned_m = behind * (z_m * by_e + z * by_e_m)
            - thickness * part * (real(2) * part_m * tilt + part * tilt_m);
        const V g_plain = optics.lamp_var * (g_xx * px_x * px_x + g_yy * px_y * px_y);
        const V g_along = optics.lamp_var
            * (g_xx * lamp_px * lamp_px + g_xy * lamp_px * lamp_py + g_yy * lamp_py * lamp_py);
        const V g_alpha = real(2) * (alpha * g_plain + turned * g_along);
        const V g_turned = real(2) * (alpha + turned * slope2) * g_along;
        g_m += real(2) * (turned * turned * g_along + g_alpha * alpha_m + g_turned * turned_m);
        const V lamp_h = g_alpha * part - g_turned * part * part * tilt;
        const V lamp_x = along * (real(2) * g_xx * lamp_px + g_xy * lamp_py) * px_x;
        const V lamp_y = along * (real(2) * g_yy * lamp_py + g_xy * lamp_px) * px_y;
"""

_LIGHT = (
    _PER_ROW
    + """
    ROW_Y
    const V number = real(columns);
    for (int j = 0; j < columns; j += 16) {
        real* const at = work.data + j;
"""
    + _PER_PHOTON
    + f"""
        const V cov = shrink * raw_xy;
        const V beta = cov / (var_y + box);
        const auto is_lit = (cosine2 > V(grazing)) & (lane_number + real(j) < number);
        V amount = optics.area * colour.radiosity;
        PASSED
        real* const to = at + {FOOTPRINT_PLANE} * plane;
        *(V*)to = is_lit ? (x + shift * h_x - optics.window_x) * px_x : V(-far);
        *(V*)(to + plane) = is_lit ? (y + shift * h_y - optics.window_y) * px_y : V(-far);
        *(V*)(to + 2 * plane) = is_lit ? root_of(shrink * raw_x + optics.min_var - beta * cov) : one;
        *(V*)(to + 3 * plane) = is_lit ? root_of(var_y) : one;
        *(V*)(to + 4 * plane) = is_lit ? beta : zero;
        *(V*)(to + 5 * plane) = is_lit ? amount : zero;
    }}
"""
)

_LIGHT_ADJOINT = (
    _PER_ROW
    + f"""
    ROW_Y
    for (int j = 0; j < columns; j += 16) {{
        real* const at = work.data + j;
        const real* const f = at + {FOOTPRINT_PLANE} * plane;
        const real* const g = at + {GRADIENT_PLANE} * plane;
        real* const to = at + {MAP_GRADIENT_PLANE} * plane;
        const V amplitude = load(f + 5 * plane);
        const auto is_lit = amplitude != zero;
        if (!__builtin_reduce_or(is_lit)) {{
            if (is_first) for (int i = 0; i < 6; ++i) *(V*)(to + i * plane) = zero;
            continue;
        }}
"""
    + _PER_PHOTON
    + """
        // --- the row's profile to the covariance (footprint.py), to that of the differentials
        const V beta = load(f + 4 * plane);
        const V g_beta = load(g + 4 * plane) / (var_y + box);
        const V g_var_x = real(0.5) * load(g + 2 * plane) / load(f + 2 * plane);
        const V g_cov = g_beta - real(2) * beta * g_var_x;
        const V g_var_y = real(0.5) * load(g + 3 * plane) / load(f + 3 * plane) + beta * (beta * g_var_x - g_beta);
        const V g_spread = shrink < one
            ? -(g_var_x * raw_x + g_cov * raw_xy + g_var_y * raw_y) * shrink / spread : zero;
        const V g_xx = amplitude * (shrink * g_var_x + g_spread);
        const V g_yy = amplitude * (shrink * g_var_y + g_spread);
        const V g_xy = amplitude * (shrink * g_cov);
        const V g_jxx = (real(2) * g_xx * j_xx + g_xy * j_yx) * unit_xx;
        const V g_jxy = (real(2) * g_xx * j_xy + g_xy * j_yy) * unit_xy;
        const V g_jyx = (real(2) * g_yy * j_yx + g_xy * j_xx) * unit_yx;
        const V g_jyy = (real(2) * g_yy * j_yy + g_xy * j_xy) * unit_yy;
        // --- landing
        const V g_x = amplitude * load(g) * px_x, g_y = amplitude * load(g + plane) * px_y;
        // --- J and landing to K, K', k, and by those M
        const V a_x = g_jxx * h_x + g_jyx * h_y, a_y = g_jxy * h_x + g_jyy * h_y;
        const V g_cross = g_jxy + g_jyx;
        const V g_shift = g_x * h_x + g_y * h_y + g_jxx * h_xx + g_cross * h_xy + g_jyy * h_yy;
        const V g_shift_m = real(2) * (a_x * v_x + a_y * v_y);
        const V g_k = a_x * h_x + a_y * h_y + g_shift * thickness;
        const V k_mm = k * k * eta * inv_root * inv_root * (real(0.5) * k * eta + real(0.25) * c * inv_root);
        const V bend1 = real(-0.5) * bend * bend * inv_root;
        const V u2 = real(-0.5) * (u1 * bend + u * bend1 - real(0.5) * u * bend * c * inv_root * inv_root) * inv_root;
        const V s2 = real(2) * (u1 * u1 + u * u2) * slope2 + real(4) * u * u1;
        const V z2 = real(0.5) * s2 * z * z * z + real(1.5) * s1 * z * z * z1;
        const V e_mm = u2 * z + real(2) * u1 * z1 + u * z2;
        V g_m = real(2) * (g_k * k_m + g_shift_m * thickness * k_mm
            + optics.gap * (g_shift * e_m + g_shift_m * e_mm));
        PASSED
        LAMP_ADJOINT
        const V g_vx = shift_m * a_x, g_vy = shift_m * a_y;
        // --- to height, slopes and second derivatives
        auto add = [&](int i, V value) __attribute__((always_inline)) {
            value = is_lit ? value : zero;
            *(V*)(to + i * plane) = is_first ? value : load(to + i * plane) + value;
        };
        add(0, lamp_h + g_shift * k + g_shift_m * k_m);
        add(1, lamp_x + g_x * shift + g_jxx * w_x + g_jxy * w_y + k * a_x + h_x * g_m + g_vx * h_xx + g_vy * h_xy);
        add(2, lamp_y + g_y * shift + g_jyx * w_x + g_jyy * w_y + k * a_y + h_y * g_m + g_vx * h_xy + g_vy * h_yy);
        add(3, g_jxx * shift + g_vx * h_x);
        add(4, g_cross * shift + g_vx * h_y + g_vy * h_x);
        add(5, g_jyy * shift + g_vy * h_y);
    }
"""
)


@cache
def row_refraction_functions(dtype: Any, has_fresnel: bool, has_lamp: bool, *, is_row: bool = True) -> tuple[Any, Any]:
    """``refract_row``: surface maps of a row to footprints, and ``refract_row_adjoint``, which adds to the gradient of
    the maps or, where ``is_first``, writes it.

    Photons of a row share ``row_y``; others (``is_row`` False) have their y in row 2 of ``across``, as all have their x
    in row 1.
    """

    def snippet(body: str, passed: str) -> str:
        body = body.replace("ROW_Y", _ROW_Y if is_row else "").replace("PHOTON_Y", "" if is_row else _PHOTON_Y)
        body = body.replace("PASSED", passed if has_fresnel else "").replace("LAMP_SIZE", _LAMP if has_lamp else "")
        body = body.replace(
            "LAMP_ADJOINT", _LAMP_ADJOINT if has_lamp else "const V lamp_h = zero, lamp_x = zero, lamp_y = zero;"
        )
        return vector_snippet(dtype, (_TRANSMISSION if has_fresnel else "") + body)

    Optics, Colour = optics_struct(dtype), colour_struct(dtype)

    @no_type_check
    @wp.func_native(snippet(_LIGHT, _PASSED))
    def refract_row(
        across: wp.array2d[dtype],
        row_y: dtype,
        colour: Colour,
        optics: Optics,
        columns: wp.int32,
        # outputs
        work: wp.array2d[dtype],
    ): ...

    @no_type_check
    @wp.func_native(snippet(_LIGHT_ADJOINT, _PASSED_ADJOINT))
    def refract_row_adjoint(
        across: wp.array2d[dtype],
        row_y: dtype,
        colour: Colour,
        optics: Optics,
        columns: wp.int32,
        is_first: wp.bool,
        # outputs
        work: wp.array2d[dtype],
    ): ...

    return refract_row, refract_row_adjoint
