"""Light from straight above for sixteen photons at a time: the pieces of C++ that ``row_refraction.py`` puts in.

The formulas and names are those of ``collimated.py``, ``fresnel.py`` and ``lamp.py``, where they are explained.
"""

_BENT = """
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
        // --- shift and its derivatives
        const V shift = thickness * k + optics.gap * e;
        const V shift_m = real(2) * (thickness * k_m + optics.gap * e_m);
        const V v_x = h_x * h_xx + h_y * h_xy, v_y = h_x * h_xy + h_y * h_yy;
        const V w_x = k * h_x + shift_m * v_x, w_y = k * h_y + shift_m * v_y;
        const V shift_x = shift * h_x, shift_y = shift * h_y;
        const V d_xx = shift * h_xx + h_x * w_x, d_xy = shift * h_xy + h_x * w_y;
        const V d_yx = shift * h_xy + h_y * w_x, d_yy = shift * h_yy + h_y * w_y;
        const auto gets_through = cosine2 > V(grazing);
        const real lit = real(1);
        const V side2 = k * k * slope2;
"""

_COSINES = """
        const V sine2 = bend * bend * slope2;
        const V cosine = root_of(one - sine2);
        const V cos_out = root_of(larger(one - ratio * ratio * sine2, V(grazing)));
"""

_PASSED = """
        amount *= transmission(one, root, eta) * transmission(cosine, cos_out, ratio);
"""

_PASSED_ADJOINT = """
        V by_one, by_root, by_cosine, by_out;
        transmission_slopes(one, root, eta, by_one, by_root);
        transmission_slopes(cosine, cos_out, ratio, by_cosine, by_out);
        const V through = by_cosine / cosine + by_out * ratio * ratio / cos_out;
        const V sine2_m = bend * bend * (one - bend * slope2 * inv_root);
        g_m += g_log * (by_root * c * inv_root - through * sine2_m);
"""

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

_ADJOINT = """
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
"""

_MAPS_ADJOINT = """
        const V g_vx = shift_m * a_x, g_vy = shift_m * a_y;
        // --- to height, slopes and second derivatives
        const V to_h = lamp_h + g_shift * k + g_shift_m * k_m;
        const V to_x = lamp_x + g_x * shift + g_jxx * w_x + g_jxy * w_y + k * a_x + h_x * g_m
            + g_vx * h_xx + g_vy * h_xy;
        const V to_y = lamp_y + g_y * shift + g_jyx * w_x + g_jyy * w_y + k * a_y + h_y * g_m
            + g_vx * h_xy + g_vy * h_yy;
        const V to_xx = g_jxx * shift + g_vx * h_x;
        const V to_xy = g_cross * shift + g_vx * h_y + g_vy * h_x;
        const V to_yy = g_jyy * shift + g_vy * h_y;
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

_NO_LAMP_ADJOINT = """
        const V lamp_h = zero, lamp_x = zero, lamp_y = zero;
"""


def collimated_pieces(has_fresnel: bool, has_lamp: bool) -> dict[str, str]:
    """What stands for each place in the frames of ``row_refraction.py``."""
    passed_adjoint = _COSINES + _PASSED_ADJOINT if has_fresnel else ""
    lamp_adjoint = _LAMP_ADJOINT if has_lamp else _NO_LAMP_ADJOINT
    return {
        "LIGHT_OF_ROW": "",
        "BENT": _BENT,
        "LAMP_SIZE": _LAMP if has_lamp else "",
        "PASSED": _COSINES + _PASSED if has_fresnel else "",
        "ADJOINT": _ADJOINT + passed_adjoint + lamp_adjoint + _MAPS_ADJOINT,
    }
