"""Printed lines along chains of points, in float64: what designs are printed with.

A path is one printed line: its height at a place is the highest that any of its pieces has there, so corners and
crossings of a line with itself are not doubled. Different paths meet as ``merging`` says.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from warp_caustics.errors import InputError
from warp_caustics.height_field import cell_centres
from warp_caustics.prints.line import MAX_SUPERSAMPLING, Line
from warp_caustics.prints.sections import CrossSection
from warp_caustics.types import FloatArray

SUM, MAX = 1.0, math.inf
"""p of lines on top of each other, (sum of h^p)^(1/p), that adds them up, and that takes the highest."""

RAISED_COSINE = CrossSection()

_BAND_POINTS = 2**22
"""Points of cells looked at together, which bounds the memory."""


@dataclass(frozen=True, eq=False)
class PrintedPath:
    """One printed line along straight pieces; width and height go linearly from point to point.

    Attributes:
        points_m: centre line [m], shape [k, 2]; one point is a round drop, a closed line ends where it starts.
        widths_m: full width at each point [m], shape [k].
        heights_m: crown height at each point [m], shape [k].
        section: of the line.
    """

    points_m: FloatArray
    widths_m: FloatArray
    heights_m: FloatArray
    section: CrossSection = RAISED_COSINE

    def __post_init__(self) -> None:
        count = len(self.points_m)
        if not count or self.points_m.shape != (count, 2):
            raise InputError(f"points have shape {list(self.points_m.shape)}; give [k, 2], k at least 1")
        if self.widths_m.shape != (count,) or self.heights_m.shape != (count,):
            raise InputError(f"a line of {count} points needs as many widths and heights; give shape [{count}]")
        for values in (self.points_m, self.widths_m, self.heights_m):
            if not np.isfinite(values).all():
                raise InputError("a printed line has a value that is not finite; give metres")
        if (self.widths_m <= 0).any() or (self.heights_m < 0).any():
            raise InputError("a printed line needs widths above 0 and heights of at least 0; check them")


def uniform_path(
    points_m: FloatArray, width_m: float, height_m: float, section: CrossSection | None = None
) -> PrintedPath:
    """A line of one width and height [m] along points [m], shape [k, 2]."""
    points = np.asarray(points_m, dtype=np.float64).reshape(-1, 2)
    count = len(points)
    return PrintedPath(points, np.full(count, width_m), np.full(count, height_m), section or RAISED_COSINE)


def path_of_line(line: Line, section: CrossSection | None = None) -> PrintedPath:
    """A straight line as a path."""
    return uniform_path(np.array([line.start_m, line.end_m]), line.width_m, line.height_m, section)


def paths_relief(
    paths: Sequence[PrintedPath],
    samples: int,
    plate_size_m: tuple[float, float],
    *,
    merging: float = SUM,
    supersampling: int = 4,
) -> FloatArray:
    """Relief of printed paths.

    Args:
        paths: any number; parts beyond the plate are cut off.
        samples: n, height samples per side.
        plate_size_m: extent along x and y [m].
        merging: p of paths on top of each other: 1 adds them up, infinity takes the highest.
        supersampling: each sample is the mean over supersampling x supersampling points of its cell.

    Returns:
        Heights above the base [m], shape [n, n]; row grows with +y, column with +x.

    Raises:
        InputError: a number that makes no relief.
    """
    if samples < 1 or not 1 <= supersampling <= MAX_SUPERSAMPLING:
        raise InputError(f"{samples} samples, supersampling {supersampling}; use at least 1, up to {MAX_SUPERSAMPLING}")
    if not merging >= 1:
        raise InputError(f"merging {merging:g} is below 1; give 1 to add lines up, more to merge them")
    fine = samples * supersampling
    x, y = (cell_centres(fine, length) for length in plate_size_m)
    relief = np.empty((samples, samples))
    band = max(1, _BAND_POINTS // (fine * supersampling))
    for first in range(0, samples, band):
        last = min(first + band, samples)
        heights = _merged(paths, x, y[first * supersampling : last * supersampling], merging)
        relief[first:last] = heights.reshape(last - first, supersampling, samples, supersampling).mean(axis=(1, 3))
    return relief


def _merged(paths: Sequence[PrintedPath], x: FloatArray, y: FloatArray, merging: float) -> FloatArray:
    """Heights at points of a plate [m], shape [len(y), len(x)]."""
    total = np.zeros((len(y), len(x)))
    # Powers of heights relative to the highest crown stay within float64.
    unit = max((float(path.heights_m.max()) for path in paths), default=0.0) or 1.0
    for path in paths:
        found = _path_patch(path, x, y)
        if found is None:
            continue
        rows, columns, heights = found
        if merging == SUM:
            total[rows, columns] += heights
        elif math.isinf(merging):
            np.maximum(total[rows, columns], heights, out=total[rows, columns])
        else:
            total[rows, columns] += (heights / unit) ** merging
    if merging == SUM or math.isinf(merging):
        return total
    return np.asarray(unit * total ** (1 / merging))


def _path_patch(path: PrintedPath, x: FloatArray, y: FloatArray) -> tuple[slice, slice, FloatArray] | None:
    """Rows and columns that a path can touch, and its height there [m]; None if it touches none."""
    half = path.widths_m.max() * path.section.reach / 2
    low, high = path.points_m.min(axis=0) - half, path.points_m.max(axis=0) + half
    columns, rows = (
        slice(*np.searchsorted(axis, (low[k], high[k]), side="left").tolist()) for k, axis in enumerate((x, y))
    )
    if columns.stop <= columns.start or rows.stop <= rows.start:
        return None
    x, y = x[columns], y[rows]
    highest = np.zeros((len(y), len(x)))
    last = len(path.points_m) - 1
    for k in range(max(1, last)):
        _add_piece(path, k, min(k + 1, last), x, y, highest)
    return rows, columns, highest


def _add_piece(path: PrintedPath, a: int, b: int, x: FloatArray, y: FloatArray, highest: FloatArray) -> None:
    """Raise ``highest`` to the heights of the piece between points a and b of a path, where it is higher."""
    start, end = path.points_m[a], path.points_m[b]
    half = max(path.widths_m[a], path.widths_m[b]) * path.section.reach / 2
    columns, rows = (
        slice(*np.searchsorted(axis, (min(start[k], end[k]) - half, max(start[k], end[k]) + half)).tolist())
        for k, axis in enumerate((x, y))
    )
    from_x, from_y = x[None, columns] - start[0], y[rows, None] - start[1]
    along = end - start
    squared = float(along @ along)
    nearest = np.clip((from_x * along[0] + from_y * along[1]) / squared, 0.0, 1.0) if squared > 0 else 0.0 * from_x
    distance = np.hypot(from_x - nearest * along[0], from_y - nearest * along[1])
    width = path.widths_m[a] + nearest * (path.widths_m[b] - path.widths_m[a])
    crown = path.heights_m[a] + nearest * (path.heights_m[b] - path.heights_m[a])
    height = crown * path.section.relative_height(2 * distance / width)
    np.maximum(highest[rows, columns], height, out=highest[rows, columns])
