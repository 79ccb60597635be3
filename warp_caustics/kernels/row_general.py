"""Light from anywhere for sixteen photons at a time: the pieces of C++ that ``row_refraction.py`` puts in.

What ``general.py`` is for one photon, in a form short enough for an adjoint by hand. With the direction of incidence
w = (w_x, w_y, -w_d), M = 1 + |grad h|^2 and c = 1 - eta^2, light inside the glass goes along

    t = eta w + g (h_x, h_y, -1),   g = c / (a + R),   a = eta (w_d + w_x h_x + w_y h_y),   R^2 = a^2 + c M,

and with D = -t_z, T = d + h and f = ratio / sqrt(1 - ratio^2 (t_x^2 + t_y^2)) it is shifted on its way to the screen by
s (t_x, t_y), s = T / D + gap f. Along any way on which w, h and grad h change by dw, dh and d grad h

    dg = -g / R (da + g grad h . d grad h),   ds = (dh - T / D dD) / D + gap f^3 t_xy . dt_xy.

``follow`` is that, along x, along y and in two directions across the lamp; ``follow_adjoint`` is its adjoint, written
by hand, and so is what ``ADJOINT`` does with its sums. Tested against ``general.py``, whose adjoint is Warp's.
"""

_TILT_ROW = """
    const real in_x = optics.tilt[0], in_y = optics.tilt[1], down = -optics.tilt[2];
"""

_LAMP_ROW = """
    const real lamp = root_of(V(optics.lamp_var))[0];
"""

_TILT_LAMP_ROW = """
    // the lamp's size along two directions across the light
    const real flat = root_of(V(in_x * in_x + down * down))[0];
    const real first_x = lamp * down / flat, first_down = -lamp * in_x / flat;
    const real second_x = -in_y * first_down, second_y = in_x * first_down - down * first_x;
    const real second_down = in_y * first_x;
"""

_FROM_SOURCE = """
        const V from_x = x - optics.light_x, from_y = y - optics.light_y, from_z = optics.light_z - thickness;
        const V inv_distance = one / root_of(from_x * from_x + from_y * from_y + from_z * from_z);
        const V in_x = from_x * inv_distance, in_y = from_y * inv_distance, down = from_z * inv_distance;
"""

_FOLLOW = """
        // --- inside the glass
        const V a = eta * (down + in_x * h_x + in_y * h_y);
        const V root = root_of(a * a + c * (one + slope2));
        const V g = c / (a + root), g_root = g / root;
        const V t_x = eta * in_x + g * h_x, t_y = eta * in_y + g * h_y, t_down = eta * down + g;
        const V inv_down = one / t_down;
        const V cosine2 = one - ratio * ratio * (t_x * t_x + t_y * t_y);
        // --- behind the bottom face
        const V f = ratio / root_of(larger(cosine2, V(grazing)));
        const V gap_f2 = optics.gap * f * f, gap_f3 = gap_f2 * f;
        const V side = thickness * inv_down;
        const V shift = side + optics.gap * f;
        const V shift_x = shift * t_x, shift_y = shift * t_y;
        const V side2 = (t_x * t_x + t_y * t_y) * inv_down * inv_down;
        // --- derivatives along a way
        struct Way { V in_x, in_y, down, h, h_x, h_y; };
        struct Followed { V v, a, g, t_x, t_y, t_down, along, shift, x, y; };
        auto follow = [&](const Way& d) __attribute__((always_inline)) -> Followed {
            Followed n;
            n.v = h_x * d.h_x + h_y * d.h_y;
            n.a = eta * (d.down + d.in_x * h_x + d.in_y * h_y + in_x * d.h_x + in_y * d.h_y);
            n.g = -g_root * (n.a + g * n.v);
            n.t_x = eta * d.in_x + n.g * h_x + g * d.h_x;
            n.t_y = eta * d.in_y + n.g * h_y + g * d.h_y;
            n.t_down = eta * d.down + n.g;
            n.along = t_x * n.t_x + t_y * n.t_y;
            n.shift = (d.h - side * n.t_down) * inv_down + gap_f3 * n.along;
            n.x = n.shift * t_x + shift * n.t_x;
            n.y = n.shift * t_y + shift * n.t_y;
            return n;
        };
"""

_TILT_WAYS = """
        const Way way_x = {zero, zero, zero, h_x, h_xx, h_xy}, way_y = {zero, zero, zero, h_y, h_xy, h_yy};
        const V lit = a / (eta * down);
        const auto gets_through = (cosine2 > V(grazing)) & (a > zero);
"""

_POINT_WAYS = """
        // the direction, where a place changes by p: what of p is across the light, over the distance
        auto turned = [&](V p_x, V p_y, V p_down, V d_h, V d_h_x, V d_h_y) __attribute__((always_inline)) -> Way {
            const V along = in_x * p_x + in_y * p_y + down * p_down;
            return Way{(p_x - in_x * along) * inv_distance, (p_y - in_y * along) * inv_distance,
                (p_down - down * along) * inv_distance, d_h, d_h_x, d_h_y};
        };
        const Way way_x = turned(one, zero, -h_x, h_x, h_xx, h_xy);
        const Way way_y = turned(zero, one, -h_y, h_y, h_xy, h_yy);
        const V nearer = optics.light_distance * inv_distance;
        const V lit = nearer * nearer * a / eta;
        const auto gets_through = (cosine2 > V(grazing)) & (a > zero) & (down >= V(optics.cos_cone));
"""

_MOVED = """
        const Followed moved_x = follow(way_x), moved_y = follow(way_y);
        const V d_xx = moved_x.x, d_xy = moved_y.x, d_yx = moved_x.y, d_yy = moved_y.y;
"""

_TILT_LAMP_WAYS = """
        const Way lamp_1 = {V(first_x), zero, V(first_down), zero, zero, zero};
        const Way lamp_2 = {V(second_x), V(second_y), V(second_down), zero, zero, zero};
"""

_POINT_LAMP_WAYS = """
        const Way lamp_1 = turned(V(lamp), zero, zero, zero, zero, zero);
        const Way lamp_2 = turned(zero, V(lamp), zero, zero, zero, zero);
"""

_LAMP = """
        const Followed blur_1 = follow(lamp_1), blur_2 = follow(lamp_2);
        raw_x += (blur_1.x * blur_1.x + blur_2.x * blur_2.x) * (px_x * px_x);
        raw_xy += (blur_1.x * blur_1.y + blur_2.x * blur_2.y) * (px_x * px_y);
        raw_y += (blur_1.y * blur_1.y + blur_2.y * blur_2.y) * (px_y * px_y);
"""

_PASSED = """
        amount *= transmission(a / eta, root, eta) * transmission(t_down, ratio / f, ratio) / colour.flat_share;
"""

_FOLLOW_ADJOINT = """
        V g_a = zero, g_r = zero, g_g = zero, g_gr = zero, g_tx = zero, g_ty = zero, g_td = zero, g_f = zero;
        V g_s = zero, g_t = zero, g_in_x = zero, g_in_y = zero, to_x = zero, to_y = zero;
        auto follow_adjoint = [&](const Way& d, const Followed& n, V by_x, V by_y) __attribute__((always_inline)) {
            const V by_s = by_x * t_x + by_y * t_y, by_along = gap_f3 * by_s, by_h = by_s * inv_down;
            g_s += by_x * n.t_x + by_y * n.t_y;
            g_f += real(3) * gap_f2 * n.along * by_s;
            g_tx += by_x * n.shift + by_along * n.t_x;
            g_ty += by_y * n.shift + by_along * n.t_y;
            g_t -= by_h * n.t_down * inv_down;
            g_td -= by_h * inv_down * (d.h - real(2) * side * n.t_down);
            const V by_tx = by_x * shift + by_along * t_x, by_ty = by_y * shift + by_along * t_y;
            const V by_td = -by_h * side;
            const V by_g = by_td + by_tx * h_x + by_ty * h_y;
            const V by_a = -g_root * by_g, by_v = by_a * g, by_w = eta * by_a;
            g_gr -= by_g * (n.a + g * n.v);
            g_g += by_tx * d.h_x + by_ty * d.h_y + by_a * n.v;
            to_x += by_tx * n.g + by_v * d.h_x + by_w * d.in_x;
            to_y += by_ty * n.g + by_v * d.h_y + by_w * d.in_y;
            g_in_x += by_w * d.h_x;
            g_in_y += by_w * d.h_y;
            return Way{eta * by_tx + by_w * h_x, eta * by_ty + by_w * h_y, eta * by_td + by_w, by_h,
                by_tx * g + by_v * h_x + by_w * in_x, by_ty * g + by_v * h_y + by_w * in_y};
        };
"""

_ADJOINT = """
        // --- J, its columns
        const Way by_x = follow_adjoint(way_x, moved_x, g_jxx, g_jyx);
        const Way by_y = follow_adjoint(way_y, moved_y, g_jxy, g_jyy);
        to_x += by_x.h;
        to_y += by_y.h;
        const V to_xx = by_x.h_x, to_xy = by_x.h_y + by_y.h_x, to_yy = by_y.h_y;
"""

_LAMP_ADJOINT = """
        const V g_bxx = real(2) * g_xx * (px_x * px_x), g_bxy = g_xy * (px_x * px_y);
        const V g_byy = real(2) * g_yy * (px_y * px_y);
        auto blur_adjoint = [&](const Way& d, const Followed& n) __attribute__((always_inline)) {
            return follow_adjoint(d, n, g_bxx * n.x + g_bxy * n.y, g_bxy * n.x + g_byy * n.y);
        };
        const Way by_1 = blur_adjoint(lamp_1, blur_1), by_2 = blur_adjoint(lamp_2, blur_2);
"""

_PASSED_ADJOINT = """
        V by_in_1, by_out_1, by_in_2, by_out_2;
        const V cos_out = ratio / f;
        transmission_slopes(a / eta, root, eta, by_in_1, by_out_1);
        transmission_slopes(t_down, cos_out, ratio, by_in_2, by_out_2);
        g_a += g_log * by_in_1 / eta;
        g_r += g_log * by_out_1;
        g_td += g_log * by_in_2;
        g_f -= g_log * by_out_2 * cos_out / f;
"""

_LANDING_ADJOINT = """
        // --- landing, shift
        g_s += g_x * t_x + g_y * t_y;
        g_t += g_s * inv_down;
        g_td -= g_s * side * inv_down;
        g_f += g_s * optics.gap;
        const V g_f3 = g_f * f * f * f;
        g_tx += g_x * shift + g_f3 * t_x;
        g_ty += g_y * shift + g_f3 * t_y;
        // --- direction inside the glass
        const V inv_root = one / root;
        g_g += g_tx * h_x + g_ty * h_y + g_td + g_gr * inv_root;
        g_r -= g_gr * g_root * inv_root;
        g_a += g_log / a + g_r * a * inv_root - g_root * g_g;
        const V by_v = g_r * c * inv_root - g_root * g * g_g, by_w = eta * g_a;
        to_x += g * g_tx + by_v * h_x + by_w * in_x;
        to_y += g * g_ty + by_v * h_y + by_w * in_y;
        V to_h = g_t;
"""

_TURNED_ADJOINT = """
        // --- directions from the source; g_far is by the logarithm of the distance
        V g_down = zero, g_far = real(-2) * g_log;
        auto turned_adjoint = [&](V p_x, V p_y, V p_down, const Way& d, const Way& by) __attribute__((always_inline)) {
            const V along = (in_x * p_x + in_y * p_y + down * p_down) * inv_distance;
            const V across = (in_x * by.in_x + in_y * by.in_y + down * by.down) * inv_distance;
            g_in_x -= along * by.in_x + across * p_x;
            g_in_y -= along * by.in_y + across * p_y;
            g_down -= along * by.down + across * p_down;
            g_far -= by.in_x * d.in_x + by.in_y * d.in_y + by.down * d.down;
            return by.down * inv_distance - down * across;
        };
        to_x -= turned_adjoint(one, zero, -h_x, way_x, by_x);
        to_y -= turned_adjoint(zero, one, -h_y, way_y, by_y);
"""

_LAMP_TURNED_ADJOINT = """
        turned_adjoint(V(lamp), zero, zero, lamp_1, by_1);
        turned_adjoint(zero, V(lamp), zero, lamp_2, by_2);
"""

_FROM_SOURCE_ADJOINT = """
        g_in_x += eta * g_tx + by_w * h_x;
        g_in_y += eta * g_ty + by_w * h_y;
        g_down += eta * g_td + by_w;
        const V outwards = in_x * g_in_x + in_y * g_in_y + down * g_down;
        to_h -= (g_down + (g_far - outwards) * down) * inv_distance;
"""


def general_pieces(has_fresnel: bool, has_lamp: bool, is_point: bool) -> dict[str, str]:
    """What stands for each place in the frames of ``row_refraction.py``: light from a point, or slanting."""
    row = ("" if is_point else _TILT_ROW) + (_LAMP_ROW if has_lamp else "")
    bent = (_FROM_SOURCE if is_point else "") + _FOLLOW + (_POINT_WAYS if is_point else _TILT_WAYS) + _MOVED
    adjoint = _FOLLOW_ADJOINT + _ADJOINT
    if has_lamp:
        row += "" if is_point else _TILT_LAMP_ROW
        adjoint += _LAMP_ADJOINT
    adjoint += (_PASSED_ADJOINT if has_fresnel else "") + _LANDING_ADJOINT
    if is_point:
        adjoint += _TURNED_ADJOINT + (_LAMP_TURNED_ADJOINT if has_lamp else "") + _FROM_SOURCE_ADJOINT
    return {
        "LIGHT_OF_ROW": row,
        "BENT": bent,
        "LAMP_SIZE": (_POINT_LAMP_WAYS if is_point else _TILT_LAMP_WAYS) + _LAMP if has_lamp else "",
        "PASSED": _PASSED if has_fresnel else "",
        "ADJOINT": adjoint,
    }
