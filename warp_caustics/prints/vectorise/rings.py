"""Lines that are nearly rings, as rings: what lies under other lines of one, or its relief tells wrongly, follows.

Where two wide rings cross, the relief of a network is wrong and each is found in pieces. These lie on one circle and
are as wide and high as each other, which tells them from what else is there.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from warp_caustics.prints.smooth_chains import POINTS_OF_NODE, Track, track_through, track_weights
from warp_caustics.prints.vectorise.curved_ends import ALIKE
from warp_caustics.prints.vectorise.curved_lines import CurvedLines
from warp_caustics.types import BoolArray, FloatArray

ROUNDS = 10
"""In which points that lie aside come to count less."""
LEAST_ASIDE_M = 3e-5
"""How far points may lie aside that count in full [m]."""
NEARLY = 0.2
"""Of a line's width that half of its points lie aside of a circle, at most."""
COVERED = 0.55
"""Of what the plate holds of a circle that lines cover, at least, for it to be printed all round."""
LONGEST = 1.35
"""Of a circle, that a way may be as long as."""
SAME = 0.5
"""Of the width that rings' middles and radii differ by, at most, that are one ring."""
BINS = 360
"""Of a circle."""
WITHIN = 0.5, 0.8
"""Of a ring's width that a point lies aside of its circle, at most, and share of such points, of what is part of it."""


@dataclass(frozen=True, eq=False)
class Ring:
    """A circle that lines lie on.

    Attributes:
        middle: [m], shape [2].
        radius: [m].
        size: width and height [m], shape [2].
        is_printed: bins of the circle where it is, shape [BINS].
        step_m: distance of printed points.
    """

    middle: FloatArray
    radius: float
    size: FloatArray
    is_printed: BoolArray
    step_m: float

    def tracks(self) -> list[Track]:
        """All round, or the arcs that the plate holds."""
        if self.is_printed.all():
            return [self._track(np.arange(self._points()) / self._points(), is_closed=True)]
        first = int(np.flatnonzero(~self.is_printed)[0])
        runs = np.flatnonzero(np.diff(np.append(np.roll(self.is_printed, -first).astype(int), 0)))
        found = []
        for start, end in runs.reshape(-1, 2):
            turns = (first + 1 + start + np.linspace(0, end - start, self._points())) / BINS
            found.append(self._track(turns, is_closed=False))
        return found

    def _points(self) -> int:
        return max(32, round(16 * np.pi * self.radius / (POINTS_OF_NODE * self.step_m)))

    def _track(self, turns: FloatArray, *, is_closed: bool) -> Track:
        angles = 2 * np.pi * turns
        points = self.middle + self.radius * np.column_stack([np.cos(angles), np.sin(angles)])
        return track_through(points, is_closed=is_closed, node_m=POINTS_OF_NODE * self.step_m)

    def share_on(self, track: Track) -> float:
        """Share of a way's points that lie on the ring."""
        return float((self._aside(track) <= WITHIN[0] * self.size[0]).mean())

    def is_same(self, other: "Ring") -> bool:
        """Whether both are the same circle, but for what a relief tells wrongly."""
        apart = np.abs([*(self.middle - other.middle), self.radius - other.radius])
        return bool(apart.max() <= SAME * self.size[0])

    def _aside(self, track: Track) -> FloatArray:
        aside: FloatArray = np.abs(np.hypot(*(points_of(track) - self.middle).T) - self.radius)
        return aside


def points_of(track: Track) -> FloatArray:
    """Printed, shape [K, 2] [m]."""
    points: FloatArray = track_weights(track) @ track.nodes_m
    return points


def circle_of(points: FloatArray) -> tuple[FloatArray, float, float]:
    """Middle [m], shape [2], and radius [m] of the circle most points are on; how far half of them is aside [m].

    Least squares of x^2 + y^2 = 2 c x + (r^2 - c^2) (Kasa 1976), again and again with points that lie aside counting
    less, for a part of a way may have gone astray.

    Args:
        points: shape [K, 2] [m].
    """
    origin = points.mean(axis=0)
    off, weight = points - origin, np.ones(len(points))
    about = np.column_stack([2 * off, np.ones(len(off))])
    middle, radius, aside = np.zeros(2), 0.0, np.full(len(points), np.inf)
    for _ in range(ROUNDS):
        found = np.linalg.lstsq(about * weight[:, None], (off**2).sum(axis=1) * weight, rcond=None)[0]
        middle = found[:2]
        radius = float(np.sqrt(max(found[2] + middle @ middle, 0.0)))
        aside = np.abs(np.hypot(*(off - middle).T) - radius)
        weight = 1 / (1 + (aside / max(float(np.median(aside)), LEAST_ASIDE_M)) ** 2)
    return origin + middle, radius, float(np.median(aside))


def with_rings(lines: CurvedLines, plate_m: tuple[float, float]) -> list[CurvedLines]:
    """Lines with those that are nearly rings, or pieces of one, as rings: several ways to say it, or none.

    One has all other lines, if there is a ring more; one those only that are not part of a ring, if others are.

    Args:
        lines: all.
        plate_m: size of the plate, which is about the origin [m].
    """
    rings, rest, is_new = list[Ring](), list[int](), False
    left = [int(k) for k in np.argsort([-track.length_m for track in lines.tracks], kind="stable")]
    while left:
        k = left.pop(0)
        pieces = [k, *_pieces_of(lines, k, left)]
        ring = _ring_through(lines, pieces, plate_m)
        if ring is None and len(pieces) > 1:
            pieces = [k]
            ring = _ring_through(lines, pieces, plate_m)
        if ring is None:
            rest.append(k)
            continue
        left = [m for m in left if m not in pieces]
        is_new = is_new or len(pieces) > 1 or not lines.tracks[k].is_closed
        if any(ring.is_same(other) for other in rings):
            is_new = True
        else:
            rings.append(ring)
    if not rings:
        return []
    aside = [k for k in rest if max(ring.share_on(lines.tracks[k]) for ring in rings) < WITHIN[1]]
    ways = [rest] if is_new else []
    return [_with(rings, lines.kept(kept)) for kept in ([*ways, aside] if len(aside) < len(rest) else ways)]


def _with(rings: Iterable[Ring], others: CurvedLines) -> CurvedLines:
    ways = [(track, ring.size) for ring in rings for track in ring.tracks()]
    return others.with_more(CurvedLines([track for track, _ in ways], np.array([size for _, size in ways])))


def _pieces_of(lines: CurvedLines, k: int, others: list[int]) -> list[int]:
    """Of other lines those on the circle that a line is on, which are about as wide and high."""
    middle, radius, _ = circle_of(points_of(lines.tracks[k]))

    def is_piece(m: int) -> bool:
        is_alike = (np.abs(np.log(lines.sizes[k] / lines.sizes[m])) <= ALIKE).all()
        if not is_alike:
            return False
        aside = np.abs(np.hypot(*(points_of(lines.tracks[m]) - middle).T) - radius)
        return bool(np.median(aside) <= WITHIN[0] * lines.sizes[k, 0])

    return [m for m in others if is_piece(m)]


def _ring_through(lines: CurvedLines, pieces: list[int], plate_m: tuple[float, float]) -> Ring | None:
    """The ring that lines are, or None where they are none; the first is the longest."""
    tracks = [lines.tracks[k] for k in pieces]
    lengths = np.array([track.length_m for track in tracks])
    size = np.average(lines.sizes[pieces], axis=0, weights=np.maximum(lengths, 1e-12))
    points = np.concatenate([points_of(track) for track in tracks])
    middle, radius, aside = circle_of(points)
    if aside > NEARLY * size[0] or not 0 < radius <= max(plate_m) or lengths.max() > LONGEST * 2 * np.pi * radius:
        return None
    angles = 2 * np.pi * (np.arange(BINS) + 0.5) / BINS
    around = middle + radius * np.column_stack([np.cos(angles), np.sin(angles)])
    is_inside = (np.abs(around) <= np.array(plate_m) / 2 + size[0] / 2).all(axis=1)
    off = points - middle
    near = np.abs(np.hypot(*off.T) - radius) <= WITHIN[0] * size[0]
    is_covered = np.zeros(BINS, bool)
    is_covered[np.floor(BINS * np.arctan2(off[near, 1], off[near, 0]) / (2 * np.pi)).astype(int) % BINS] = True
    # Printed points may lie farther apart than bins: a gap of one step is none.
    reach = int(np.ceil(BINS * tracks[0].step_m / (2 * np.pi * radius)))
    for shift in range(1, reach + 1):
        is_covered |= np.roll(is_covered, shift)
    if not is_inside.any() or (is_covered & is_inside).sum() < COVERED * is_inside.sum():
        return None
    return Ring(middle, radius, size, is_inside, tracks[0].step_m)
