"""Curves that fibres are laid along, as chains of points close enough to the curve.

All lengths in metres; points have shape [k, 2]. A chain deviates from its curve by at most ``FLATNESS_M``.
"""

import math
from collections.abc import Sequence

import numpy as np

from warp_caustics.errors import InputError
from warp_caustics.types import FloatArray

FLATNESS_M = 1e-6
"""Largest distance of a curve from its chain [m]: at a slope of 45 degrees 1 um of height."""

MOST_PIECES = 4096


def bezier_points(control_m: FloatArray, flatness_m: float = FLATNESS_M) -> FloatArray:
    """Points of a Bezier curve of any degree.

    A curve of degree n, cut in N equal parts of its parameter, is within n (n - 1) / (8 N^2) max |second difference of
    the control points| of its chords: the bound of the second derivative in the error of linear interpolation.

    Args:
        control_m: control points [m], shape [n + 1, 2].
        flatness_m: largest deviation [m].

    Raises:
        InputError: fewer than two control points, or more than 16.
    """
    control = np.asarray(control_m, dtype=np.float64)
    degree = len(control) - 1
    if control.shape != (degree + 1, 2) or not 1 <= degree <= 15:
        raise InputError(f"a Bezier curve of control points {list(control.shape)}; give 2 to 16 points (x, y)")
    bend = np.hypot(*np.diff(control, n=2, axis=0).T).max() if degree > 1 else 0.0
    pieces = max(1, math.ceil(math.sqrt(degree * (degree - 1) * bend / (8 * flatness_m))))
    t = np.linspace(0.0, 1.0, min(pieces, MOST_PIECES) + 1)[:, None]
    weights = [math.comb(degree, k) * t**k * (1 - t) ** (degree - k) for k in range(degree + 1)]
    return np.asarray(sum(weight * point for weight, point in zip(weights, control, strict=True)))


def arc_points(
    centre_m: Sequence[float], radius_m: float, start_rad: float, turn_rad: float, flatness_m: float = FLATNESS_M
) -> FloatArray:
    """Points of an arc that starts at an angle from the x axis and turns, to the left if positive."""
    # A chord of an angle a is r (1 - cos(a / 2)) from its arc.
    half = math.acos(max(0.0, 1 - flatness_m / radius_m)) if radius_m > flatness_m else math.pi / 3
    pieces = min(max(2, math.ceil(abs(turn_rad) / (2 * half))), MOST_PIECES)
    angles = start_rad + turn_rad * np.linspace(0.0, 1.0, pieces + 1)
    return np.stack([centre_m[0] + radius_m * np.cos(angles), centre_m[1] + radius_m * np.sin(angles)], axis=1)


def ring_points(centre_m: Sequence[float], radius_m: float, flatness_m: float = FLATNESS_M) -> FloatArray:
    """Points of a circle, the last one the first again; of radius 0 the centre alone."""
    if radius_m <= 0:
        return np.array([centre_m], dtype=np.float64)
    points = arc_points(centre_m, radius_m, 0.0, 2 * math.pi, flatness_m)
    points[-1] = points[0]
    return points


def meander_points(
    centre_m: Sequence[float], length_m: float, spacing_m: float, rows: int, angle_rad: float = 0.0
) -> FloatArray:
    """Points of a line laid to and fro: straight rows joined by half circles.

    Args:
        centre_m: centre (x, y) of the patch [m].
        length_m: of the straight part of a row [m].
        spacing_m: distance of neighbouring rows [m], the diameter of the turns.
        rows: how many.
        angle_rad: direction of the rows, from the x axis [rad].

    Raises:
        InputError: no rows, or lengths that are not above 0.
    """
    if not 1 <= rows <= MOST_PIECES or not (length_m > 0 and spacing_m > 0):
        raise InputError(
            f"meander of {rows} rows of {length_m:g} m, {spacing_m:g} m apart; give at least 1 row, lengths above 0"
        )
    parts = []
    for row in range(rows):
        y, side = (row - (rows - 1) / 2) * spacing_m, 1 if row % 2 == 0 else -1
        parts.append(np.array([[-side * length_m / 2, y], [side * length_m / 2, y]]))
        if row < rows - 1:
            turn = arc_points((side * length_m / 2, y + spacing_m / 2), spacing_m / 2, -math.pi / 2, side * math.pi)
            parts.append(turn[1:-1])
    return placed(np.concatenate(parts), centre_m, angle_rad)


def placed(points_m: FloatArray, centre_m: Sequence[float], angle_rad: float) -> FloatArray:
    """Points turned to the left around the origin, then moved by a centre."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    turned = np.asarray(points_m, dtype=np.float64) @ np.array([[c, s], [-s, c]])
    return np.asarray(turned + np.asarray(centre_m, dtype=np.float64))
