"""Printed lines as a height field in float64: the oracle of the kernels, and what one relief needs.

A line is a glass fibre fused onto the plate; lines on top of each other are added. No source gives its cross section.
Three families, each with an exponent g; t = 2 r / w is 0 on the centre line and 1 at the edge. Gaussian lines may have
feet beyond, out to t = e:

=========  =====================================================  ==========================================
family     height / H                                             special cases
=========  =====================================================  ==========================================
cosine     cos(pi t / 2)^(2 g)                                    g = 1: raised cosine; 0.5: quarter cosine
parabola   (1 - t^2)^g                                            g = 1: parabola; 0.5: ellipse
gaussian   exp(-k t^2), less its value at t = e, k = 4 ln 2 g     g = 1: half its height at t = 1/2, as the cosine
=========  =====================================================  ==========================================

The two that lines are fitted with (:data:`Section`) are cosines.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from warp_caustics.errors import InputError
from warp_caustics.height_field import cell_centres
from warp_caustics.types import FloatArray

MAX_LINES = 10_000
MAX_SUPERSAMPLING = 64

Section = Literal["cosine", "quarter"]
"""``cosine``: H/2 (1 + cos(2 pi r / w)), which meets the plate without a kink; ``quarter``: H cos(pi r / w), which is
steepest there. Both are 0 from r = w/2 on. The supplement only says "a cosine falloff from their center to the edge of
their width"."""

SECTIONS: tuple[Section, ...] = get_args(Section)

COSINE_EXPONENT: dict[Section, float] = {"cosine": 1.0, "quarter": 0.5}
"""g of each section, both of which are of the family of cosines."""

Family = Literal["cosine", "parabola", "gaussian"]
FAMILIES: tuple[Family, ...] = get_args(Family)
"""In the order of their numbers in the kernels."""


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
            raise InputError(
                f"a line {self.width_m * 1e3:g} mm wide and {self.height_m * 1e3:g} mm high is none; give a width "
                "above 0 and a height of at least 0"
            )


def section_height(t: FloatArray, family: Family, exponent: float, reach: float = 1.0) -> FloatArray:
    """Height of a section relative to its crown [1], any shape; 0 from the edge on; see the table above.

    Args:
        t: distance from the centre line in units of half the width [1].
        family: of the section.
        exponent: g.
        reach: e of a Gaussian; other sections end at t = 1.
    """
    inside = np.clip(t, 0.0, reach)
    if family == "cosine":
        height = np.cos(np.pi / 2 * inside) ** (2 * exponent)
    elif family == "parabola":
        height = (1 - inside**2) ** exponent
    else:
        k = 4 * np.log(2) * exponent
        edge = np.exp(-k * reach**2)
        height = (np.exp(-k * inside**2) - edge) / (1 - edge)
    return np.where(t < reach, height, 0.0)


def line_profile(distance_m: FloatArray, width_m: float, height_m: float, section: Section = "cosine") -> FloatArray:
    """Height of a line at a distance from its centre segment.

    Args:
        distance_m: r [m], any shape.
        width_m: full width w [m].
        height_m: H [m].
        section: see :data:`Section`.

    Returns:
        Heights [m], shape of ``distance_m``; 0 from r = w/2 on.
    """
    if section not in SECTIONS:
        raise InputError(f"section {section!r} is not known; use one of {', '.join(SECTIONS)}")
    return height_m * section_height(2 * distance_m / width_m, "cosine", COSINE_EXPONENT[section])


def line_relief(
    lines: Sequence[Line],
    samples: int,
    plate_size_m: tuple[float, float],
    *,
    section: Section = "cosine",
    supersampling: int = 4,
) -> FloatArray:
    """Relief of printed lines, added up.

    Args:
        lines: any number; parts beyond the plate are cut off.
        samples: n, height samples per side.
        plate_size_m: extent along x and y [m].
        section: of the lines, see :data:`Section`.
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
        rows, columns, patch = line_patch(line, samples, plate_size_m, section=section, supersampling=supersampling)
        relief[rows, columns] += patch
    return relief


def line_patch(
    line: Line,
    samples: int,
    plate_size_m: tuple[float, float],
    *,
    section: Section = "cosine",
    supersampling: int = 4,
) -> tuple[slice, slice, FloatArray]:
    """Relief of one line where it is: rows and columns of a relief [n, n], and the heights there [m]."""
    x, y = (cell_centres(samples, length) for length in plate_size_m)
    pitch = tuple(length / samples for length in plate_size_m)
    rows, columns = _reach(line, 1, y, pitch[1]), _reach(line, 0, x, pitch[0])
    patch = np.zeros((rows.stop - rows.start, columns.stop - columns.start))
    # Most cells around an inclined line are bare: points within cells are looked at only where it can be.
    distance = distance_to_segment(line.start_m, line.end_m, x[None, columns], y[rows, None])
    touched = np.nonzero(distance < line.width_m / 2 + math.hypot(*pitch) / 2)
    within = (np.arange(supersampling) + 0.5) / supersampling - 0.5
    points_x = x[columns][touched[1], None, None] + within[None, None, :] * pitch[0]
    points_y = y[rows][touched[0], None, None] + within[None, :, None] * pitch[1]
    distance = distance_to_segment(line.start_m, line.end_m, points_x, points_y)
    fine = line_profile(distance, line.width_m, line.height_m, section)
    patch[touched] = fine.mean(axis=(1, 2))
    return rows, columns, patch


def _reach(line: Line, axis: int, centres_m: FloatArray, pitch_m: float) -> slice:
    """Cells along an axis that the line can touch."""
    ends = line.start_m[axis], line.end_m[axis]
    half = line.width_m / 2 + pitch_m / 2
    return slice(*np.searchsorted(centres_m, (min(ends) - half, max(ends) + half)).tolist())


def distance_to_segment(
    start_m: tuple[float, float], end_m: tuple[float, float], x_m: FloatArray, y_m: FloatArray
) -> FloatArray:
    """Distance of points from a segment, whose ends are round [m]; shape of x and y together."""
    along_x, along_y = end_m[0] - start_m[0], end_m[1] - start_m[1]
    from_x, from_y = x_m - start_m[0], y_m - start_m[1]
    length_squared = along_x**2 + along_y**2
    nearest: FloatArray | float = 0.0
    if length_squared > 0.0:
        nearest = np.clip((from_x * along_x + from_y * along_y) / length_squared, 0.0, 1.0)
    distance: FloatArray = np.hypot(from_x - nearest * along_x, from_y - nearest * along_y)
    return distance


def direction(line: Line) -> tuple[float, float]:
    """Unit vector from start to end; that of x for a drop."""
    along_x, along_y = line.end_m[0] - line.start_m[0], line.end_m[1] - line.start_m[1]
    length = math.hypot(along_x, along_y)
    return (along_x / length, along_y / length) if length > 0 else (1.0, 0.0)


def moved_across(line: Line, start_m: float, end_m: float) -> Line:
    """The line with its ends moved to its left [m]."""
    c, s = direction(line)
    (x0, y0), (x1, y1) = line.start_m, line.end_m
    return replace(line, start_m=(x0 - s * start_m, y0 + c * start_m), end_m=(x1 - s * end_m, y1 + c * end_m))


def moved_along(line: Line, distance_m: float) -> Line:
    """The line moved from start towards end [m]."""
    c, s = (distance_m * part for part in direction(line))
    (x0, y0), (x1, y1) = line.start_m, line.end_m
    return replace(line, start_m=(x0 + c, y0 + s), end_m=(x1 + c, y1 + s))
