"""Refraction for a row or a block of photons, sixteen at a time, on a CPU: frames of C++ that all light shares.

A frame goes from surface maps to footprints or back; what is between the relief and the shift of a path, its
derivatives and the light it carries is put in from ``row_collimated.py`` or ``row_general.py``. Formulas and names are
those of ``footprint.py`` and ``fresnel.py``, where they are explained.
"""

from typing import Any, no_type_check

import warp as wp

from warp_caustics.kernels.effects import Effects
from warp_caustics.kernels.footprint import BOX_VARIANCE
from warp_caustics.kernels.general import FAR_PX, GRAZING
from warp_caustics.kernels.made_once import made_once
from warp_caustics.kernels.photons import colour_struct, optics_struct
from warp_caustics.kernels.row_collimated import collimated_pieces
from warp_caustics.kernels.row_general import general_pieces
from warp_caustics.kernels.vectors import vector_snippet

FOOTPRINT_PLANE, GRADIENT_PLANE, MAP_GRADIENT_PLANE, SIDE_PLANE, PLANES = 6, 12, 18, 24, 25
"""Scratch memory of a row: surface maps (MAP_NAMES), footprints (members of ``footprint_struct``), their gradient for
unit amplitude in the same order, the gradient of the maps, and the square of how far a path inside the glass goes
sideways per depth, where somebody asks for second hits."""

MOST_VARIANCE = 1.0e37
"""Footprints with a larger trace [px^2] are not finite in float32."""

_PER_ROW = f"""
    const size_t plane = work.shape[1];
    const real eta = colour.eta, ratio = colour.ratio, c = real(1) - eta * eta;
    const bool is_squeezed = optics.squeeze > real(0);
    const real inv_squeeze = is_squeezed ? real(1) / optics.squeeze : real(0);
    const real px_x = optics.pixels_per_m_x, px_y = optics.pixels_per_m_y;
    const real box = real({BOX_VARIANCE!r}), grazing = real({GRAZING!r}), far = real({FAR_PX!r});
    const real most = real({MOST_VARIANCE!r});
    LIGHT_OF_ROW
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
        // --- shift_x, shift_y [m], their derivatives d_xx, d_xy, d_yx, d_yy [1], lit [1], gets_through, side2 [1]
        BENT
        // --- Jacobian, times the footprint's standard deviations on the plate
        V sigma_of_x = optics.sigma0;
        if (is_squeezed) sigma_of_x = smaller(sigma_of_x, (optics.half_x - __builtin_elementwise_abs(x)) * inv_squeeze);
        const V unit_xx = sigma_of_x * px_x, unit_yx = sigma_of_x * px_y;
        const auto unit_xy = sigma_of_y * px_x, unit_yy = sigma_of_y * px_y;
        const V j_xx = (one + d_xx) * unit_xx, j_xy = d_xy * unit_xy;
        const V j_yx = d_yx * unit_yx, j_yy = (one + d_yy) * unit_yy;
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

_LIGHT = (
    _PER_ROW
    + """
    ROW_Y
    const V number = real(end);
    for (int j = begin; j < end; j += 16) {
        real* const at = work.data + j;
"""
    + _PER_PHOTON
    + f"""
        const V cov = shrink * raw_xy;
        const V beta = cov / (var_y + box);
        const V column = (x + shift_x - optics.window_x) * px_x, row = (y + shift_y - optics.window_y) * px_y;
        const auto is_lit = gets_through & (lane_number + real(j) < number) & (spread < V(most))
            & (__builtin_elementwise_abs(column) < V(far)) & (__builtin_elementwise_abs(row) < V(far));
        V amount = optics.area * colour.radiosity * lit;
        PASSED
        real* const to = at + {FOOTPRINT_PLANE} * plane;
        *(V*)to = is_lit ? column : V(-far);
        *(V*)(to + plane) = is_lit ? row : V(-far);
        *(V*)(to + 2 * plane) = is_lit ? root_of(shrink * raw_x + optics.min_var - beta * cov) : one;
        *(V*)(to + 3 * plane) = is_lit ? root_of(var_y) : one;
        *(V*)(to + 4 * plane) = is_lit ? beta : zero;
        *(V*)(to + 5 * plane) = is_lit ? amount : zero;
        SIDEWAYS
    }}
"""
)

_LIGHT_ADJOINT = (
    _PER_ROW
    + f"""
    ROW_Y
    for (int j = 0; j < columns; j += 16) {{
        real* const at = work.data + j;
        const real* const footprint = at + {FOOTPRINT_PLANE} * plane;
        const real* const gradient = at + {GRADIENT_PLANE} * plane;
        real* const to = at + {MAP_GRADIENT_PLANE} * plane;
        const V amplitude = load(footprint + 5 * plane);
        const auto is_lit = amplitude != zero;
        if (!__builtin_reduce_or(is_lit)) {{
            if (is_first) for (int i = 0; i < 6; ++i) *(V*)(to + i * plane) = zero;
            continue;
        }}
"""
    + _PER_PHOTON
    + """
        // --- the row's profile to the covariance (footprint.py), to that of the differentials
        const V beta = load(footprint + 4 * plane);
        const V g_beta = load(gradient + 4 * plane) / (var_y + box);
        const V g_var_x = real(0.5) * load(gradient + 2 * plane) / load(footprint + 2 * plane);
        const V g_cov = g_beta - real(2) * beta * g_var_x;
        const V g_var_y = real(0.5) * load(gradient + 3 * plane) / load(footprint + 3 * plane)
            + beta * (beta * g_var_x - g_beta);
        const V g_spread = shrink < one
            ? -(g_var_x * raw_x + g_cov * raw_xy + g_var_y * raw_y) * shrink / spread : zero;
        const V g_xx = amplitude * (shrink * g_var_x + g_spread);
        const V g_yy = amplitude * (shrink * g_var_y + g_spread);
        const V g_xy = amplitude * (shrink * g_cov);
        const V g_jxx = (real(2) * g_xx * j_xx + g_xy * j_yx) * unit_xx;
        const V g_jxy = (real(2) * g_xx * j_xy + g_xy * j_yy) * unit_xy;
        const V g_jyx = (real(2) * g_yy * j_yx + g_xy * j_xx) * unit_yx;
        const V g_jyy = (real(2) * g_yy * j_yy + g_xy * j_xy) * unit_yy;
        // --- landing, and the logarithm of the amplitude
        const V g_x = amplitude * load(gradient) * px_x, g_y = amplitude * load(gradient + plane) * px_y;
        const V g_log = amplitude * load(gradient + 5 * plane);
        // --- to_h, to_x, to_y, to_xx, to_xy, to_yy: to height, slopes and second derivatives
        ADJOINT
        auto add = [&](int i, V value) __attribute__((always_inline)) {
            value = is_lit ? value : zero;
            *(V*)(to + i * plane) = is_first ? value : load(to + i * plane) + value;
        };
        add(0, to_h);
        add(1, to_x);
        add(2, to_y);
        add(3, to_xx);
        add(4, to_xy);
        add(5, to_yy);
    }
"""
)


@made_once
def row_refraction_functions(dtype: Any, effects: Effects, *, is_row: bool = True) -> tuple[Any, Any]:
    """``refract_row``: surface maps of some columns of a row to footprints; and ``refract_row_adjoint``, which adds to
    the gradient of the maps or, where ``is_first``, writes it.

    Photons of a row share ``row_y``; others (``is_row`` False) have their y in row 2 of ``across``, as all have their x
    in row 1.
    """
    if effects.is_straight:
        pieces = collimated_pieces(effects.fresnel, effects.lamp)
    else:
        pieces = general_pieces(effects.fresnel, effects.lamp, effects.point)
    sideways = f"        *(V*)(at + {SIDE_PLANE} * plane) = side2;\n" if effects.second_hits else ""
    pieces |= {"SIDEWAYS": sideways}
    pieces |= {"ROW_Y": _ROW_Y if is_row else "", "PHOTON_Y": "" if is_row else _PHOTON_Y}

    def snippet(frame: str) -> str:
        # A place is a line of its own.
        lines = (pieces.get(line.strip(), line + "\n") for line in frame.splitlines())
        return vector_snippet(dtype, (_TRANSMISSION if effects.fresnel else "") + "".join(lines))

    Optics, Colour = optics_struct(dtype), colour_struct(dtype)

    @no_type_check
    @wp.func_native(snippet(_LIGHT))
    def refract_row(
        across: wp.array2d[dtype],
        row_y: dtype,
        colour: Colour,
        optics: Optics,
        begin: wp.int32,
        end: wp.int32,
        # outputs
        work: wp.array2d[dtype],
    ): ...

    @no_type_check
    @wp.func_native(snippet(_LIGHT_ADJOINT))
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
