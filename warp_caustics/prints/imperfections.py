"""What a machine does to the lines that it was told: waves along them, ends that are thicker.

A share widens and raises a line alike, so that its section keeps its shape and a cap its contact angle; its glass
goes with the square.
"""

import numpy as np

from warp_caustics.prints.chains import Chains, subdivided, with_points
from warp_caustics.types import FloatArray

POINTS_PER_WAVE = 8
"""Of the shorter wave: straight pieces between so many points are within 5 % of both waves' amplitude."""
SECOND_WAVE = 1.6180339887498949
"""Wavelength over that of the second wave: no rational, so that waves along a line do not repeat."""
WEIGHTS = (0.6, 0.4)
"""Of both waves: together at most 1."""
END_PLACES = (0.2, 0.4, 0.6, 0.8, 1.0, 1.25, 1.5, 1.8, 2.2, 2.8)
"""Where thicker ends get points, in lengths of the end."""


def wavy(
    chains: Chains, share: FloatArray, sideways_m: FloatArray, wavelength_m: FloatArray, phases_rad: FloatArray
) -> Chains:
    """Lines whose width and height, and whose way, vary as two waves along them.

    Args:
        chains: K lines.
        share: largest change of width and height, relative [1], shape [K], below 1.
        sideways_m: largest distance from the line that was meant [m], shape [K].
        wavelength_m: of the longer wave [m], shape [K]; rounded to whole waves on closed lines.
        phases_rad: two of the thickness, two of the way, shape [K, 4].
    """
    # The shorter wave needs the points.
    chains = subdivided(chains, wavelength_m / (SECOND_WAVE * POINTS_PER_WAVE))
    line, arc = chains.line, chains.arc_m
    length, is_closed = chains.lengths_m, chains.closed
    thickness, way = np.zeros(len(arc)), np.zeros(len(arc))
    for k, (weight, wave) in enumerate(zip(WEIGHTS, (wavelength_m, wavelength_m / SECOND_WAVE), strict=True)):
        whole = length / np.maximum(1.0, np.round(length / wave))
        wave = np.where(is_closed, whole, wave)
        turns = 2 * np.pi * arc / wave[line]
        thickness += weight * np.sin(turns + phases_rad[line, k])
        way += weight * np.sin(turns + phases_rad[line, 2 + k])
    factor = 1 + share[line] * thickness
    points = chains.points_m + (sideways_m[line] * way)[:, None] * _normals(chains)
    points[chains.last[is_closed]] = points[chains.first[is_closed]]
    return Chains(points, chains.widths_m * factor, chains.heights_m * factor, chains.first)


def thick_ends(chains: Chains, share: FloatArray, length_m: FloatArray) -> Chains:
    """Lines that are thicker where the machine starts and stops: by share exp(-(s / l)^2) at a way s from an end.

    A closed line has one such place, its seam; a drop has none.

    Args:
        chains: K lines.
        share: more width and height at the ends, relative [1], shape [K].
        length_m: l [m], shape [K].
    """
    lengths = chains.lengths_m
    near = np.minimum(length_m[:, None] * np.array(END_PLACES), lengths[:, None])
    lines = np.repeat(np.arange(len(lengths)), len(END_PLACES))
    places = np.concatenate([near.ravel(), (lengths[:, None] - near).ravel()])
    chains = with_points(chains, np.concatenate([lines, lines]), places)
    line, arc = chains.line, chains.arc_m
    lengths = chains.lengths_m
    from_end = np.minimum(arc, lengths[line] - arc)
    factor = 1 + np.where(lengths > 0, share, 0.0)[line] * np.exp(-((from_end / length_m[line]) ** 2))
    return Chains(chains.points_m, chains.widths_m * factor, chains.heights_m * factor, chains.first)


def _normals(chains: Chains) -> FloatArray:
    """Unit normals to the left at each point, shape [N, 2]: of the mean direction of the pieces that meet there."""
    points = chains.points_m
    ahead = np.zeros_like(points)
    ahead[:-1] = np.diff(points, axis=0)
    ahead[chains.last] = 0.0
    ahead /= np.maximum(np.hypot(*ahead.T), 1e-30)[:, None]
    behind = np.zeros_like(points)
    behind[1:] = ahead[:-1]
    behind[chains.first] = 0.0
    is_closed = chains.closed
    first, last = chains.first[is_closed], chains.last[is_closed]
    behind[first], ahead[last] = behind[last], ahead[first]
    along = ahead + behind
    along /= np.maximum(np.hypot(*along.T), 1e-30)[:, None]
    return np.stack([-along[:, 1], along[:, 0]], axis=1)
