"""Lines that are nearly rings, as rings: what lies under other lines of one, or its relief tells wrongly, follows."""

import numpy as np

from warp_caustics.prints.smooth_chains import POINTS_OF_NODE, Track, track_through, track_weights
from warp_caustics.prints.vectorise.curved_lines import CurvedLines
from warp_caustics.types import FloatArray

ROUNDS = 10
"""In which points that lie aside come to count less."""
LEAST_ASIDE_M = 3e-5
"""How far points may lie aside that count in full [m]."""
NEARLY = 0.2
"""Of a line's width that half of its points lie aside of a circle, at most."""
TURNS = 0.55, 1.35
"""Of a circle, that a way may be as long as."""
SAME = 0.5
"""Of the width that rings' middles and radii differ by, at most, that are one ring."""


def circle_of(track: Track) -> tuple[FloatArray, float, float]:
    """Middle [m], shape [2], and radius [m] of the circle most of a way is on; how far half of it is aside [m].

    Least squares of x^2 + y^2 = 2 c x + (r^2 - c^2) (Kasa 1976), again and again with points that lie aside counting
    less, for a part of a way may have gone astray.
    """
    points = track_weights(track) @ track.nodes_m
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


def as_rings(lines: CurvedLines) -> CurvedLines | None:
    """Lines with those that are nearly rings as rings, two of the same as one; None where none is."""
    tracks, sizes, circles = list[Track](), list[FloatArray](), list[FloatArray]()
    is_other = False
    for k in np.argsort([-track.length_m for track in lines.tracks], kind="stable"):
        track, size = lines.tracks[k], lines.sizes[k]
        middle, radius, aside = circle_of(track)
        share = track.length_m / max(2 * np.pi * radius, 1e-12)
        if track.corners or aside > NEARLY * size[0] or not TURNS[0] <= share <= TURNS[1]:
            tracks.append(track)
            sizes.append(size)
            continue
        is_other = True
        circle = np.array([*middle, radius])
        if any(np.abs(circle - known).max() <= SAME * size[0] for known in circles):
            continue
        circles.append(circle)
        tracks.append(_ring(middle, radius, POINTS_OF_NODE * track.step_m))
        sizes.append(size)
    return CurvedLines(tracks, np.array(sizes)) if is_other else None


def _ring(middle_m: FloatArray, radius_m: float, node_m: float) -> Track:
    turns = np.linspace(0, 2 * np.pi, max(32, round(16 * np.pi * radius_m / node_m)), endpoint=False)
    points = middle_m + radius_m * np.column_stack([np.cos(turns), np.sin(turns)])
    return track_through(points, is_closed=True, node_m=node_m)
