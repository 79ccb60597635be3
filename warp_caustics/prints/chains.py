"""Many printed lines along points at once: how long they are, points between points, and as rows.

Arrays hold the points of all lines one after another, so that prints of thousands of pieces cost a few calls. What
becomes of a line depends on nothing but that line, to the bit: a sample is the same alone and in a batch.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from warp_caustics.prints.curves import ring_points
from warp_caustics.prints.rows import BEGIN, JOINED, RING, ROW_COLUMNS, SEGMENT
from warp_caustics.types import FloatArray

IntArray = npt.NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Chains:
    """Lines along points, N points of K lines.

    Attributes:
        points_m: [m], shape [N, 2].
        widths_m: full width at each point [m], shape [N].
        heights_m: crown height at each point [m], shape [N].
        first: index of each line's first point, shape [K].
    """

    points_m: FloatArray
    widths_m: FloatArray
    heights_m: FloatArray
    first: IntArray

    @cached_property
    def line(self) -> IntArray:
        """Number of each point's line, shape [N]."""
        numbers = np.zeros(len(self.points_m), dtype=np.intp)
        numbers[self.first[1:]] = 1
        return np.cumsum(numbers)

    @cached_property
    def last(self) -> IntArray:
        """Index of each line's last point, shape [K]."""
        return np.append(self.first[1:], len(self.points_m)) - 1

    @cached_property
    def arc_m(self) -> FloatArray:
        """Way from the line's first point [m], shape [N]."""
        # Line by line: sums over all lines would round otherwise in another batch.
        counts = self.last - self.first + 1
        steps = np.zeros((len(counts), int(counts.max(initial=1))))
        place = np.arange(len(self.points_m)) - self.first[self.line]
        length = np.hypot(*np.diff(self.points_m, axis=0).T)
        steps[self.line[1:], place[1:]] = np.where(place[1:] > 0, length, 0.0)
        return np.asarray(np.cumsum(steps, axis=1)[self.line, place])

    @cached_property
    def lengths_m(self) -> FloatArray:
        """Length of each line [m], shape [K]."""
        return self.arc_m[self.last]

    @cached_property
    def closed(self) -> npt.NDArray[np.bool_]:
        """Which lines end where they begin, shape [K]; drops do not."""
        is_same = (self.points_m[self.first] == self.points_m[self.last]).all(axis=1)
        return np.asarray(is_same & (self.last > self.first))


def chains_of(
    lines: Sequence[FloatArray], widths_m: Sequence[float] | FloatArray, heights_m: Sequence[float] | FloatArray
) -> Chains:
    """Lines along points [m], each of shape [k, 2], of one width and height each [m]."""
    counts = np.array([len(points) for points in lines], dtype=np.intp)
    return Chains(
        np.concatenate([np.zeros((0, 2)), *lines]),
        np.repeat(np.asarray(widths_m, dtype=np.float64), counts),
        np.repeat(np.asarray(heights_m, dtype=np.float64), counts),
        np.cumsum(counts) - counts,
    )


def chains_of_rows(rows: FloatArray) -> Chains:
    """Rows, shape [L, 7] (ROW_COLUMNS) [m], as lines along points; rings become closed lines."""
    is_ring = rows[:, 0] == RING
    # A segment brings its start with its own width and height; a beginning row, and a drop, are one point.
    is_point = (rows[:, 0] == BEGIN) | ((rows[:, 0] == SEGMENT) & (rows[:, 1:3] == rows[:, 3:5]).all(axis=1))
    rings = [ring_points((x, y), radius) for x, y, radius in rows[is_ring, 1:4].tolist()]
    counts = np.where((rows[:, 0] == JOINED) | is_point, 1, 2)
    counts[is_ring] = [len(ring) for ring in rings]
    row = np.repeat(np.arange(len(rows)), counts)
    begins = np.cumsum(counts) - counts
    points = rows[row, 3:5]
    starts = (rows[:, 0] == SEGMENT) & ~is_point
    points[begins[starts]] = rows[starts, 1:3]
    points[is_ring[row]] = np.concatenate([np.zeros((0, 2)), *rings])
    return Chains(points, rows[row, 5], rows[row, 6], begins[rows[:, 0] != JOINED])


def rows_of(chains: Chains) -> FloatArray:
    """Rows that print the lines, shape [N, 7] (ROW_COLUMNS): one for each point."""
    rows = np.zeros((len(chains.points_m), len(ROW_COLUMNS)))
    rows[:, 0] = JOINED
    rows[:, 3:5], rows[:, 5], rows[:, 6] = chains.points_m, chains.widths_m, chains.heights_m
    rows[1:, 1:3] = chains.points_m[:-1]
    rows[chains.first, 1:3] = chains.points_m[chains.first]
    rows[chains.first, 0] = np.where(chains.last > chains.first, BEGIN, SEGMENT)
    return rows


def with_points(chains: Chains, lines: IntArray, arcs_m: FloatArray) -> Chains:
    """The same lines with points at more places.

    Args:
        chains: K lines.
        lines: numbers of lines, shape [M].
        arcs_m: ways from their first points [m], shape [M], within the lines' lengths.
    """
    own, arc = chains.line, chains.arc_m
    line, place = np.concatenate([own, lines]), np.concatenate([arc, arcs_m])
    is_old = np.arange(len(line)) < len(own)
    # Line by line and on along each; at the same place the old point comes first, and is the one that stays.
    order = np.lexsort((~is_old, place, line))
    line, place = line[order], place[order]
    before = np.cumsum(is_old[order]) - 1
    stays = np.ones(len(line), dtype=bool)
    stays[1:] = (np.diff(line) > 0) | (np.diff(place) > 0)
    line, place, before = line[stays], place[stays], before[stays]
    after = np.minimum(before + 1, chains.last[line])
    gap = arc[after] - arc[before]
    part = np.where(gap > 0, (place - arc[before]) / np.where(gap > 0, gap, 1.0), 0.0)

    def between(values: FloatArray) -> FloatArray:
        step = values[after] - values[before]
        return np.asarray(values[before] + (part if values.ndim == 1 else part[:, None]) * step)

    return Chains(
        between(chains.points_m),
        between(chains.widths_m),
        between(chains.heights_m),
        np.searchsorted(line, np.arange(len(chains.first))),
    )


def subdivided(chains: Chains, steps_m: FloatArray) -> Chains:
    """The same lines with points no further apart than a step of each line [m], shape [K]."""
    lengths = chains.lengths_m
    pieces = np.maximum(1, np.ceil(lengths / steps_m)).astype(np.intp)
    lines = np.repeat(np.arange(len(pieces)), pieces)
    number = np.arange(len(lines)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    return with_points(chains, lines, number * (lengths / pieces)[lines])
