"""Ends of lines with corners and curves: where two may be one line, and where one may be two."""

from dataclasses import dataclass

import numpy as np

from warp_caustics.prints.smooth_chains import POINTS_OF_NODE, Track, track_through, track_weights
from warp_caustics.prints.vectorise.curved_lines import CurvedLines
from warp_caustics.types import BoolArray, FloatArray

FEWEST_NODES = 6
"""Of a line that is cut off."""
ALIKE = 0.3
"""Largest difference of the logarithms of width and height of lines that may be one."""
MEETING_WIDTHS, MEETING_M = 0.8, 8e-4
"""How far ends that may be one place lie apart, at most, by a line's width and in metres."""
CORNER_SINE = 0.3
"""Of the angle from which on two ways meet in a corner, where they cross when drawn on."""
CORNER_M = 5e-4
"""How far from their ends, at least, that may be [m]."""


@dataclass(frozen=True, eq=False)
class Meeting:
    """Two ends that may be one place.

    Attributes:
        lines: whose ends; twice the same where a line meets itself.
        tracks: ways in which they may be one.
        size: width and height [m], shape [2].
        key: of the pair.
    """

    lines: tuple[int, int]
    tracks: tuple[Track, ...]
    size: FloatArray
    key: tuple[float, ...]


def meetings(lines: CurvedLines) -> list[Meeting]:
    """Ends of lines that are near each other, of lines that are alike, the nearest first."""
    found = []
    for a, one in enumerate(lines.tracks):
        for b, other in enumerate(lines.tracks[a:], start=a):
            if one.is_closed or other.is_closed:
                continue
            sizes = lines.sizes[[a, b]]
            if (np.abs(np.log(sizes[0] / sizes[1])) > ALIKE).any():
                continue
            lengths = np.array([one.length_m, other.length_m])
            size = (sizes * lengths[:, None]).sum(0) / lengths.sum()
            for of_one in (0, -1):
                for of_other in (0, -1):
                    if a == b and (of_one, of_other) != (0, -1):
                        continue
                    ends = one.nodes_m[of_one], other.nodes_m[of_other]
                    gap = float(np.hypot(*(ends[0] - ends[1])))
                    if gap > max(MEETING_WIDTHS * size[0], MEETING_M) or (a == b and one.length_m < 4 * size[0]):
                        continue
                    tracks = (closed(one),) if a == b else joined_tracks(one, of_one, other, of_other)
                    key = (*ends[0], *ends[1])
                    found.append((gap, Meeting((a, b), tracks, size, key)))
    return [pair for _, pair in sorted(found, key=lambda each: each[0])]


def cuts(track: Track, most: int) -> list[tuple[Track, Track]]:
    """Ways to cut a way in two, at nodes all along it; none of one that is closed or short.

    Args:
        track: the way.
        most: number of them.
    """
    count, found = len(track.nodes_m), []
    if track.is_closed or count < 2 * FEWEST_NODES:
        return []
    places = np.linspace(FEWEST_NODES - 1, count - FEWEST_NODES, min(most, count - 2 * FEWEST_NODES + 2))
    for k in np.unique(np.rint(places).astype(int)).tolist():
        first = Track(track.nodes_m[: k + 1].copy(), tuple(c for c in track.corners if c < k), step_m=track.step_m)
        second = Track(track.nodes_m[k:].copy(), tuple(c - k for c in track.corners if c > k), step_m=track.step_m)
        found.append((first, second))
    return found


def without_stretch(track: Track, is_inside: BoolArray) -> list[Track] | None:
    """What is left of a way without its longest stretch of nodes that are inside; None if that is short.

    Args:
        track: the way.
        is_inside: shape [N].
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[False], is_inside, [False]]).astype(int)))
    if track.is_closed or not len(edges):
        return None
    first, last = max(edges.reshape(-1, 2).tolist(), key=lambda run: run[1] - run[0])
    if last - first < FEWEST_NODES:
        return None
    found = []
    for start, end in ((0, first), (last, len(is_inside))):
        if end - start >= FEWEST_NODES:
            corners = tuple(c - start for c in track.corners if start < c < end - 1)
            found.append(Track(track.nodes_m[start:end].copy(), corners, step_m=track.step_m))
    return found


def closed(track: Track) -> Track:
    """A line that meets itself, smooth all the way."""
    weights = track_weights(track)
    return track_through((weights @ track.nodes_m)[:-1], is_closed=True, node_m=POINTS_OF_NODE * track.step_m)


def joined_tracks(one: Track, of_one: int, other: Track, of_other: int) -> tuple[Track, ...]:
    """One way through two that meet in these ends: with a corner there, and without."""
    first = one if of_one == -1 else reverse(one)
    second = other if of_other == 0 else reverse(other)
    middle = (first.nodes_m[-1] + second.nodes_m[0]) / 2
    crossing = corner_of(first, second)
    at = crossing if crossing is not None else middle
    nodes = np.concatenate([first.nodes_m[:-1], at[None], second.nodes_m[1:]])
    place = len(first.nodes_m) - 1
    corners = (*first.corners, place, *(place + k for k in second.corners))
    smooth = (*first.corners, *(place + k for k in second.corners))
    return Track(nodes, corners, step_m=one.step_m), Track(nodes, smooth, step_m=one.step_m)


def corner_of(first: Track, second: Track) -> FloatArray | None:
    """Where the end of one way and the start of another meet, both drawn on straight; None where that is far."""
    end, start = first.nodes_m[-1], second.nodes_m[0]
    one, two = end - first.nodes_m[-2], second.nodes_m[1] - start
    sine = one[0] * two[1] - one[1] * two[0]
    lengths = np.hypot(*one) * np.hypot(*two)
    if abs(sine) < CORNER_SINE * lengths:
        return None
    apart = start - end
    far = (apart[0] * two[1] - apart[1] * two[0]) / sine
    place = end + far * one
    middle = (end + start) / 2
    found: FloatArray = place
    return found if np.hypot(*(place - middle)) < max(np.hypot(*apart), 5e-4) else None


def reverse(track: Track) -> Track:
    """The same way backwards."""
    last = len(track.nodes_m) - 1
    return Track(track.nodes_m[::-1].copy(), tuple(last - k for k in track.corners[::-1]), step_m=track.step_m)
