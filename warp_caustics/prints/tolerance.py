"""The tolerance zone of printed lines on the samples of a height map.

A height sample is a mean over its cell. A fibre narrower than a cell hardly has
a slope on these samples, and yet moves much glass from one cell to the next when
it lies a little aside. So the zone follows from the lines: each may lie up to
the tolerance t aside or along, and the surface up to t above or below.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from warp_caustics.prints.fit import shifted
from warp_caustics.prints.line import Line, Section, line_patch
from warp_caustics.types import FloatArray


def line_limit(
    lines: Sequence[Line],
    samples: int,
    plate_size_m: tuple[float, float],
    tolerance_m: float,
    *,
    profile: Section = "cosine",
) -> FloatArray:
    """Largest vertical deviation inside the zone [m], shape [n, n].

    sqrt(t^2 + sum of squares of what moving each line by t across, and along, changes): for lines much wider than a
    cell the same as t sqrt(1 + s^2) with the surface's slope s.

    Args:
        lines: as designed.
        samples: n.
        plate_size_m: extent along x and y [m].
        tolerance_m: t [m].
        profile: of the lines.
    """
    squared = np.full((samples, samples), tolerance_m**2)
    for line in lines:
        here = _relief(line, samples, plate_size_m, profile)
        for forth, back in (
            (shifted(line, tolerance_m, tolerance_m), shifted(line, -tolerance_m, -tolerance_m)),
            (_along(line, tolerance_m), _along(line, -tolerance_m)),
        ):
            changes = [np.abs(_relief(each, samples, plate_size_m, profile) - here) for each in (forth, back)]
            squared += np.maximum(*changes) ** 2
    limit: FloatArray = np.sqrt(squared)
    return limit


def _along(line: Line, distance_m: float) -> Line:
    along = np.subtract(line.end_m, line.start_m)
    length = float(np.hypot(*along))
    move = distance_m * along / length if length > 0 else np.array([distance_m, 0.0])
    start, end = np.add(line.start_m, move), np.add(line.end_m, move)
    return replace(line, start_m=(float(start[0]), float(start[1])), end_m=(float(end[0]), float(end[1])))


def _relief(line: Line, samples: int, plate_size_m: tuple[float, float], profile: Section) -> FloatArray:
    rows, columns, patch = line_patch(line, samples, plate_size_m, profile=profile)
    relief = np.zeros((samples, samples))
    relief[rows, columns] = patch
    return relief
