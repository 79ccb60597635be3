"""Ways of lines with curves: ridges of a relief, followed through crossings.

A ridge is where a relief, smoothed as widely as its line is wide, is curved most across (Steger 1998,
10.1109/34.659930; the scale by Lindeberg's normalised strength). What is followed goes straight on, as curved as it
was, where another line lies on top: lines on top only raise a relief.
"""

import math
from dataclasses import dataclass

import numpy as np
import scipy  # loads its parts when they are first used

from warp_caustics.types import BoolArray, FloatArray, IntArray

SCALES = (0.8, 1.2, 1.8, 2.7, 4.0)
"""Standard deviations of the smoothing [samples]."""
SCALE_POWER = 1.5
"""By which curvatures at different scales compare (gamma = 3/4)."""
STEP = 0.5
"""Of following [samples]."""
SEED_ANISOTROPY = 0.6
"""Share by which a ridge that is followed first is less curved along than across: crossings are not."""
TURN = math.cos(math.radians(40))
"""A ridge that is followed keeps within this angle from step to step of its smoothing."""
WEAKEST = 0.25
"""Share of its strength where it begins that a ridge keeps, unless another line lies on top."""
LOWEST = 0.55
"""Share of a line's height below which a relief does not have that line."""
GAP_STEPS = 8
"""For which a ridge may be lost under others, and as many for each sample of its scale."""
SHORTEST = 2.0
"""Of a way [samples]."""
OWN_PART = 0.6
"""Scales to either side within which ridges of about the same direction belong to one that was followed, at least 1."""
MOST_STEPS = 4000
ARC_POINTS = 12
"""Of a part of a way that may be an arc."""
LEAST_RADIUS, LEAST_TURN, ARC_OFF = 1.5, 0.8, 0.35
"""Of an arc: radius [samples], angle [rad], and how far off its circle it is (root mean square) [samples]."""
BARE = 0.25
"""Strength of a raised cosine, about, relative to its height."""


@dataclass(frozen=True, eq=False)
class Ridge:
    """A way that a ridge takes.

    Attributes:
        points: column and row, shape [P, 2] [samples]; sample centres are whole numbers.
        scale: standard deviation of the smoothing at which it is clearest [samples].
        is_closed: it ends where it begins.
    """

    points: FloatArray
    scale: float
    is_closed: bool = False

    @property
    def length(self) -> float:
        """Of the way [samples]."""
        return float(np.hypot(*np.diff(self.points, axis=0).T).sum())


class _Curvatures:
    """Second derivatives of a relief at one scale."""

    def __init__(self, relief: FloatArray, scale: float):
        def smoothed(rows: int, columns: int) -> FloatArray:
            found: FloatArray = scipy.ndimage.gaussian_filter(relief, scale, order=(rows, columns), mode="constant")
            return found

        self.scale = scale
        self.fields = np.stack(
            [smoothed(0, 0), smoothed(0, 1), smoothed(1, 0), smoothed(0, 2), smoothed(1, 1), smoothed(2, 0)]
        )

    def at(self, place: FloatArray) -> "_Across":
        """At a column and row, between samples; beyond the plate as on its rim."""
        rows, columns = self.fields.shape[1:]
        x, y = min(max(float(place[0]), 0.0), columns - 1.0), min(max(float(place[1]), 0.0), rows - 1.0)
        j, i = min(int(x), columns - 2), min(int(y), rows - 2)
        x, y = x - j, y - i
        corner = self.fields[:, i : i + 2, j : j + 2]
        upper, lower = ((1 - x) * corner[:, k, 0] + x * corner[:, k, 1] for k in (0, 1))
        return _Across((1 - y) * upper + y * lower, self.scale)


class _Across:
    """What is across a place: the strongest negative curvature, its direction, and how far the ridge is that way."""

    def __init__(self, values: FloatArray, scale: float):
        self.height, x, y, xx, xy, yy = values.tolist()
        middle, half = (xx + yy) / 2, math.hypot((xx - yy) / 2, xy)
        least, other = middle - half, middle + half
        angle = 0.5 * math.atan2(2 * xy, xx - yy) + math.pi / 2  # of the most negative curvature
        self.normal = np.array([math.cos(angle), math.sin(angle)])
        self.along = np.array([-self.normal[1], self.normal[0]])
        self.strength = -least * scale**SCALE_POWER
        self.anisotropy = 1 - abs(other) / max(-least, 1e-30)
        slope = x * self.normal[0] + y * self.normal[1]
        self.offset = slope / max(-least, 1e-30)


def ridges_of(relief_m: FloatArray, least_m: float) -> list[Ridge]:
    """Ways of the ridges of a relief, the clearest first.

    Args:
        relief_m: shape [n, n] [m].
        least_m: height of the lowest lines [m].
    """
    levels = [_Curvatures(relief_m, scale) for scale in SCALES]
    strength, level, along, anisotropy, offset = _maps(levels)
    is_free = (np.abs(offset) < 0.7) & (strength > BARE * least_m) & (anisotropy > SEED_ANISOTROPY)
    order = np.argsort(-(strength * np.clip(anisotropy, 0, 1)), axis=None)
    found = []
    columns, rows = np.meshgrid(np.arange(relief_m.shape[1]), np.arange(relief_m.shape[0]))
    for flat in order.tolist():
        i, j = divmod(flat, relief_m.shape[1])
        if not is_free[i, j]:
            continue
        is_free[i, j] = False
        ridge = _followed(levels[level[i, j]], np.array([j, i], dtype=np.float64), along[:, i, j])
        if ridge is None or ridge.length < max(SHORTEST, ridge.scale):
            continue
        found.append(ridge)
        _mark(is_free, along, ridge, columns, rows)
    return found


def circles_of(ridges: list[Ridge]) -> list[Ridge]:
    """Circles that parts of ridges are arcs of: rings are lost where others lie on top, and their circle is not."""
    found: list[Ridge] = []
    known: list[FloatArray] = []
    for ridge in ridges:
        count = len(ridge.points)
        for parts in (1, 2, 3):
            length = count // parts
            if length < ARC_POINTS:
                break
            for first in range(0, count - length + 1, max(1, length // 2)):
                circle = _circle(ridge.points[first : first + length])
                if circle is None or any(np.abs(circle - other).max() < 1.0 for other in known):
                    continue
                known.append(circle)
                x, y, radius = circle
                angles = np.linspace(0.0, 2 * np.pi, max(12, round(2 * np.pi * radius / STEP)), endpoint=False)
                points = np.stack([x + radius * np.cos(angles), y + radius * np.sin(angles)], axis=1)
                found.append(Ridge(points, ridge.scale, is_closed=True))
    return found


def _circle(points: FloatArray) -> FloatArray | None:
    """Centre and radius, shape [3] [samples], of the circle that points [P, 2] lie on; None where they lie on none."""
    middle = points.mean(axis=0)
    x, y = (points - middle).T
    terms = np.stack([x, y, np.ones_like(x)], axis=1)
    solution, *_ = np.linalg.lstsq(terms, x**2 + y**2, rcond=None)
    centre = solution[:2] / 2
    radius = math.sqrt(max(float(solution[2] + centre @ centre), 0.0))
    off = np.abs(np.hypot(x - centre[0], y - centre[1]) - radius)
    turn = np.hypot(*np.diff(points, axis=0).T).sum() / max(radius, 1e-9)
    if radius < LEAST_RADIUS or turn < LEAST_TURN or float(np.sqrt(np.mean(off**2))) > ARC_OFF:
        return None
    return np.array([*(centre + middle), radius])


def _maps(levels: list[_Curvatures]) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """At every sample the strongest ridge: its strength, level, direction [2, n, n], anisotropy and offset."""
    found = []
    for level in levels:
        _, x, y, xx, xy, yy = level.fields
        middle, half = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
        least, other = middle - half, middle + half
        angle = 0.5 * np.arctan2(2 * xy, xx - yy) + np.pi / 2
        normal = np.stack([np.cos(angle), np.sin(angle)])
        down = np.maximum(-least, 1e-30)
        offset = (x * normal[0] + y * normal[1]) / down
        found.append((-least * level.scale**SCALE_POWER, normal, 1 - np.abs(other) / down, offset))
    best = np.argmax([each[0] for each in found], axis=0)

    def chosen(values: list[FloatArray]) -> FloatArray:
        return np.asarray(np.take_along_axis(np.stack(values), best[None], axis=0)[0])

    normal = np.stack([chosen([each[1][axis] for each in found]) for axis in range(2)])
    along = np.stack([-normal[1], normal[0]])
    return chosen([e[0] for e in found]), best, along, chosen([e[2] for e in found]), chosen([e[3] for e in found])


def _followed(level: _Curvatures, start: FloatArray, along: FloatArray) -> Ridge | None:
    """The ridge through a place, both ways."""
    here = level.at(start)
    start = start + np.clip(here.offset, -0.7, 0.7) * here.normal
    here = level.at(start)
    forth, is_closed = _one_way(level, start, along, here.strength, here.height)
    if is_closed:
        return Ridge(np.array([start, *forth]), level.scale, is_closed=True)
    back, _ = _one_way(level, start, -along, here.strength, here.height)
    points = np.array([*back[::-1], start, *forth])
    return Ridge(points, level.scale) if len(points) > 1 else None


def _one_way(
    level: _Curvatures, start: FloatArray, along: FloatArray, strength: float, height: float
) -> tuple[list[FloatArray], bool]:
    """Places from a start on, and whether they come back to it."""
    place, way, bend, points, seen = start, along, 0.0, list[FloatArray](), 0
    lost, most_lost = 0, GAP_STEPS + round(GAP_STEPS * level.scale)
    n = level.fields.shape[1:]
    for _ in range(MOST_STEPS):
        turn = bend if lost else 0.0
        way = np.array(
            [way[0] * math.cos(turn) - way[1] * math.sin(turn), way[0] * math.sin(turn) + way[1] * math.cos(turn)]
        )
        place = place + STEP * way
        if not (-1 <= place[0] <= n[1] and -1 <= place[1] <= n[0]):
            break
        here = level.at(place)
        if here.height < LOWEST * height:
            break
        cosine = float(here.along @ way)
        is_seen = here.strength > WEAKEST * strength and abs(cosine) > TURN and abs(here.offset) < 1.0
        if is_seen and here.strength < 2.5 * strength:
            place = place + 0.6 * np.clip(here.offset, -0.4, 0.4) * here.normal
            tangent = here.along if cosine > 0 else -here.along
            new = 0.5 * way + 0.5 * tangent
            new = new / np.hypot(*new)
            turned = math.atan2(way[0] * new[1] - way[1] * new[0], float(way @ new))
            bend = 0.8 * bend + 0.2 * turned
            way, lost = new, 0
            height = min(height, max(here.height, 0.8 * height))
            points.append(place)
            seen = len(points)
        else:
            lost += 1
            if lost > most_lost:
                break
            points.append(place)
        if len(points) > 16 and np.hypot(*(place - start)) < 1.0 and float(way @ along) > 0.7:
            return points[:-2], True
    return points[:seen], False


def _mark(is_free: BoolArray, along: FloatArray, ridge: Ridge, columns: IntArray, rows: IntArray) -> None:
    """Take samples near a ridge, whose own ridges go about the same way, out of those that are free."""
    radius = max(1.0, OWN_PART * 1.6 * ridge.scale)
    ways = np.gradient(ridge.points, axis=0)
    ways = ways / np.maximum(np.hypot(*ways.T), 1e-12)[:, None]
    reach = math.ceil(radius)
    for (x, y), way in zip(ridge.points[::2], ways[::2], strict=True):
        i, j = round(float(y)), round(float(x))
        part = (slice(max(i - reach, 0), i + reach + 1), slice(max(j - reach, 0), j + reach + 1))
        is_near = (columns[part] - x) ** 2 + (rows[part] - y) ** 2 <= radius**2
        is_alike = np.abs(along[0][part] * way[0] + along[1][part] * way[1]) > 0.7
        is_free[part] &= ~(is_near & is_alike)
