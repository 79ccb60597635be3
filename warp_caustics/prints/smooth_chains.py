"""Lines whose way is smooth between corners: a few nodes each, cubic B-splines between them, and the points printed.

Points follow from nodes by a matrix, so that a gradient by points is one by nodes at once.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise

import numpy as np
import scipy  # loads its parts when they are first used

from warp_caustics.types import FloatArray

DEGREE = 3
NODE_M = 8e-4
"""Nodes lie about so far apart [m]: two samples of the paper's grid."""
POINTS_OF_NODE = 5.3
"""Printed points for each: on the paper's grid 0.15 mm apart, of a curve of radius 1 mm a chord is 3 um off."""
STEP_M = NODE_M / POINTS_OF_NODE


@dataclass(frozen=True, eq=False)
class Track:
    """The way of one line.

    Attributes:
        nodes_m: of its splines, shape [N, 2] [m].
        corners: places in ``nodes_m`` where its direction may jump, without its ends.
        is_closed: it goes on from its last node to its first.
        step_m: about how far printed points lie apart [m].
    """

    nodes_m: FloatArray
    corners: tuple[int, ...] = ()
    is_closed: bool = False
    step_m: float = STEP_M

    @property
    def length_m(self) -> float:
        """Of the polygon of its nodes [m]."""
        nodes = np.concatenate([self.nodes_m, self.nodes_m[:1]]) if self.is_closed else self.nodes_m
        return float(np.hypot(*np.diff(nodes, axis=0).T).sum())

    def at(self, nodes_m: FloatArray) -> "Track":
        """With its nodes elsewhere."""
        return replace(self, nodes_m=nodes_m)


@lru_cache(maxsize=512)
def spline_weights(nodes: int, points: int, *, is_closed: bool = False) -> FloatArray:
    """Weights of nodes in points evenly spaced in the parameter, shape [points, nodes].

    Open splines begin and end in their first and last node; with fewer nodes than a cubic needs the degree is less.

    Args:
        nodes: at least 1; at least 3 if closed.
        points: at least 1; of a closed one the last is the first again.
        is_closed: whether it goes round.
    """
    if nodes == 1:
        return np.ones((points, 1))
    if is_closed:
        degree = min(DEGREE, nodes - 1)
        knots = np.arange(-degree, nodes + degree + 1, dtype=np.float64)
        at = np.linspace(0.0, nodes, points)
        wrapped = scipy.interpolate.BSpline.design_matrix(at, knots, degree).toarray()
        weights = np.zeros((points, nodes))
        for column in range(wrapped.shape[1]):
            weights[:, column % nodes] += wrapped[:, column]
        return weights
    degree = min(DEGREE, nodes - 1)
    inner = np.linspace(0.0, 1.0, nodes - degree + 1)
    knots = np.concatenate([np.zeros(degree), inner, np.ones(degree)])
    found: FloatArray = scipy.interpolate.BSpline.design_matrix(np.linspace(0.0, 1.0, points), knots, degree).toarray()
    return found


def track_weights(track: Track) -> FloatArray:
    """Weights of a track's nodes in its printed points, shape [K, N]."""
    step_m = track.step_m
    count = len(track.nodes_m)
    if track.is_closed:
        return spline_weights(count, _points(track.length_m, step_m), is_closed=True)
    ends = [0, *track.corners, count - 1]
    rows = []
    for first, last in pairwise(ends):
        stretch = Track(track.nodes_m[first : last + 1])
        own = np.zeros((_points(stretch.length_m, step_m), count))
        own[:, first : last + 1] = spline_weights(last + 1 - first, len(own))
        rows.append(own if first == 0 else own[1:])
    return np.concatenate(rows) if rows else np.ones((1, 1))


def _points(length_m: float, step_m: float) -> int:
    return max(2, int(np.ceil(length_m / step_m)) + 1)


def track_through(points_m: FloatArray, *, is_closed: bool = False, node_m: float = NODE_M) -> Track:
    """The track without corners that passes points as nearly as its nodes allow, by least squares.

    Args:
        points_m: along the way, not all the same, shape [P, 2] [m]; of a closed one without the first again.
        is_closed: whether it goes round.
        node_m: distance of nodes [m].
    """
    if is_closed:
        points_m = np.concatenate([points_m, points_m[:1]])
    way = np.append(0.0, np.cumsum(np.hypot(*np.diff(points_m, axis=0).T)))
    length = float(way[-1])
    fewest = 4 if is_closed else 2
    count = max(fewest, round(length / node_m) + (0 if is_closed else 1))
    places = max(4 * count, 16)
    at = np.linspace(0.0, length, places)
    even = np.stack([np.interp(at, way, axis) for axis in points_m.T], axis=1)
    weights = spline_weights(count, places, is_closed=is_closed)
    if is_closed:
        return Track(np.linalg.lstsq(weights, even, rcond=None)[0], is_closed=True, step_m=node_m / POINTS_OF_NODE)
    nodes = np.empty((count, 2))
    nodes[0], nodes[-1] = even[0], even[-1]
    if count > 2:
        rest = even - weights[:, [0, -1]] @ nodes[[0, -1]]
        nodes[1:-1] = np.linalg.lstsq(weights[:, 1:-1], rest, rcond=None)[0]
    return Track(nodes, step_m=node_m / POINTS_OF_NODE)


class TrackPoints:
    """Printed points of some tracks as functions of all their nodes.

    Args:
        tracks: at least one; their nodes may move, as long as lengths stay about as they are.
    """

    def __init__(self, tracks: Sequence[Track]):
        self.tracks = list(tracks)
        self._weights = [track_weights(track) for track in tracks]
        self.most = max(len(own) for own in self._weights)
        self._ends = np.cumsum([len(track.nodes_m) for track in tracks])[:-1]

    @property
    def nodes_m(self) -> FloatArray:
        """Of all tracks, one after the other, shape [N, 2] [m]."""
        return np.concatenate([track.nodes_m for track in self.tracks])

    def of(self, nodes_m: FloatArray) -> FloatArray:
        """Points [m], shape [L, K, 2], for nodes of all tracks, shape [N, 2]. The last is repeated."""
        points = np.empty((len(self.tracks), self.most, 2))
        for own, weights, nodes in zip(points, self._weights, self._split(nodes_m), strict=True):
            own[: len(weights)] = weights @ nodes
            own[len(weights) :] = own[len(weights) - 1]
        return points

    def back(self, by_point: FloatArray) -> FloatArray:
        """Gradient by nodes, shape [N, 2], from that by points, shape [L, K, 2]."""
        found = []
        for own, weights in zip(by_point, self._weights, strict=True):
            used = own[: len(weights)].copy()
            used[-1] += own[len(weights) :].sum(axis=0)
            found.append(weights.T @ used)
        return np.concatenate(found)

    def tracks_at(self, nodes_m: FloatArray) -> list[Track]:
        """The tracks with these nodes, shape [N, 2] [m]."""
        return [track.at(part) for track, part in zip(self.tracks, self._split(nodes_m), strict=True)]

    def _split(self, nodes_m: FloatArray) -> list[FloatArray]:
        return np.split(nodes_m, self._ends)
