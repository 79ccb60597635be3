"""Printed lines as a height field: a glass fibre fused onto the plate, lines on top of each other added."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from warp_caustics.errors import InputError
from warp_caustics.height_field import cell_centres
from warp_caustics.types import FloatArray

MAX_LINES = 10_000
MAX_SUPERSAMPLING = 64

Section = Literal["cosine", "quarter"]
"""``cosine``: H/2 (1 + cos(2 pi r / w)); ``quarter``: H cos(pi r / w); both 0 from r = w/2 on."""


@dataclass(frozen=True)
class Line:
    """A fused fibre along a straight segment.

    Attributes:
        start_m: (x, y) of one end of the centre line [m], from the plate's centre.
        end_m: (x, y) of the other end [m]; equal to the start it is a round drop.
        width_m: full width w [m].
        height_m: height H above the plate on the centre line [m]; 0 is a missing fibre.
    """

    start_m: tuple[float, float]
    end_m: tuple[float, float]
    width_m: float
    height_m: float

    def __post_init__(self) -> None:
        numbers = (*self.start_m, *self.end_m, self.width_m, self.height_m)
        if not all(math.isfinite(number) for number in numbers):
            raise InputError(f"{self} has a value that is not finite; give metres")
        if self.width_m <= 0 or self.height_m < 0:
            raise InputError(f"{self} needs a width above 0 and a height of at least 0")


def line_profile(distance_m: FloatArray, width_m: float, height_m: float, profile: Section = "cosine") -> FloatArray:
    """Height of a line at a distance from its centre segment.

    Args:
        distance_m: r [m], any shape.
        width_m: full width w [m].
        height_m: H [m].
        profile: ``"cosine"``, H/2 (1 + cos(2 pi r / w)), which meets the plate without a kink; or
            ``"quarter"``, H cos(pi r / w), which is steepest there. The supplement only says
            "a cosine falloff from their center to the edge of their width".

    Returns:
        Heights [m], shape of ``distance_m``; 0 from r = w/2 on.
    """
    if profile not in get_args(Section):
        raise InputError(f"profile {profile!r} is not known; use one of {', '.join(get_args(Section))}")
    angle = np.pi * distance_m / width_m
    inside = (1 + np.cos(2 * angle)) / 2 if profile == "cosine" else np.cos(angle)
    return np.where(distance_m < width_m / 2, height_m * inside, 0.0)


def line_relief(
    lines: Sequence[Line],
    samples: int,
    plate_size_m: tuple[float, float],
    *,
    profile: Section = "cosine",
    supersampling: int = 4,
) -> FloatArray:
    """Relief of printed lines, added up.

    Args:
        lines: any number; parts beyond the plate are cut off.
        samples: n, height samples per side.
        plate_size_m: extent along x and y [m].
        profile: see :func:`line_profile`.
        supersampling: each sample is the mean over supersampling x supersampling points of its
            cell; 1 samples at the cell's centre, and misses lines narrower than a cell.

    Returns:
        Heights above the base [m], shape [n, n]; row grows with +y, column with +x.

    Raises:
        InputError: a number that makes no relief.
    """
    if samples < 1 or not 1 <= supersampling <= MAX_SUPERSAMPLING:
        raise InputError(f"{samples} samples, supersampling {supersampling}; use at least 1, up to {MAX_SUPERSAMPLING}")
    relief = np.zeros((samples, samples))
    for line in lines:
        rows, columns, patch = line_patch(line, samples, plate_size_m, profile=profile, supersampling=supersampling)
        relief[rows, columns] += patch
    return relief


def line_patch(
    line: Line,
    samples: int,
    plate_size_m: tuple[float, float],
    *,
    profile: Section = "cosine",
    supersampling: int = 4,
) -> tuple[slice, slice, FloatArray]:
    """Relief of one line where it is: rows and columns of a relief [n, n], and the heights there [m]."""
    x, y = (cell_centres(samples, length) for length in plate_size_m)
    pitch = tuple(length / samples for length in plate_size_m)
    rows, columns = _reach(line, 1, y, pitch[1]), _reach(line, 0, x, pitch[0])
    patch = np.zeros((rows.stop - rows.start, columns.stop - columns.start))
    # Most cells around an inclined line are bare: points within cells are looked at only where it can be.
    distance = _distance_to_segment(line, x[None, columns], y[rows, None])
    touched = np.nonzero(distance < line.width_m / 2 + math.hypot(*pitch) / 2)
    within = (np.arange(supersampling) + 0.5) / supersampling - 0.5
    points_x = x[columns][touched[1], None, None] + within[None, None, :] * pitch[0]
    points_y = y[rows][touched[0], None, None] + within[None, :, None] * pitch[1]
    fine = line_profile(_distance_to_segment(line, points_x, points_y), line.width_m, line.height_m, profile)
    patch[touched] = fine.mean(axis=(1, 2))
    return rows, columns, patch


def _reach(line: Line, axis: int, centres_m: FloatArray, pitch_m: float) -> slice:
    """Cells along an axis that the line can touch."""
    ends = line.start_m[axis], line.end_m[axis]
    half = line.width_m / 2 + pitch_m / 2
    return slice(*np.searchsorted(centres_m, (min(ends) - half, max(ends) + half)).tolist())


def _distance_to_segment(line: Line, x: FloatArray, y: FloatArray) -> FloatArray:
    """Distance of points to the line's centre segment [m]; ends are round."""
    along_x, along_y = line.end_m[0] - line.start_m[0], line.end_m[1] - line.start_m[1]
    from_x, from_y = x - line.start_m[0], y - line.start_m[1]
    length_squared = along_x**2 + along_y**2
    nearest: FloatArray | float = 0.0
    if length_squared > 0.0:
        nearest = np.clip((from_x * along_x + from_y * along_y) / length_squared, 0.0, 1.0)
    distance: FloatArray = np.hypot(from_x - nearest * along_x, from_y - nearest * along_y)
    return distance
