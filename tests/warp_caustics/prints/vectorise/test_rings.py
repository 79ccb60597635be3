"""Lines that are nearly rings."""

import numpy as np
import pytest

from warp_caustics.prints.curves import ring_points
from warp_caustics.prints.smooth_chains import Track, track_through
from warp_caustics.prints.vectorise.curved_lines import CurvedLines
from warp_caustics.prints.vectorise.rings import as_rings, circle_of

MIDDLE, RADIUS = (4e-3, -2e-3), 7e-3
ROUND = ring_points(MIDDLE, RADIUS)[:-1]
WIDTH = 1.5e-3


def lines_of(*tracks):
    return CurvedLines(list(tracks), np.tile([WIDTH, 4e-4], (len(tracks), 1)))


def astray(share, part=0.15):
    """Most of a circle, whose last part goes off on a tangent."""
    kept = ROUND[: int(share * len(ROUND))]
    count = int(part * len(ROUND))
    step = kept[-1] - kept[-2]
    return track_through(np.concatenate([kept, kept[-1] + step * np.arange(1, count)[:, None]]))


@pytest.mark.parametrize("share", [0.65, 0.9])
def test_the_circle_is_that_of_most_of_a_way(share):
    middle, radius, aside = circle_of(astray(share))
    np.testing.assert_allclose(middle, MIDDLE, atol=5e-5)
    assert radius == pytest.approx(RADIUS, abs=5e-5) and aside < 5e-5


def test_what_is_nearly_a_ring_becomes_one():
    other = Track(1e-3 * np.array([[-20.0, 5.0], [-5.0, 9.0], [10.0, 5.0]]))
    rings = as_rings(lines_of(astray(0.8), other))
    assert rings is not None and [track.is_closed for track in rings.tracks] == [True, False]
    assert rings.tracks[1] is other
    points = rings.tracks[0].nodes_m - MIDDLE
    np.testing.assert_allclose(np.hypot(*points.T), RADIUS, rtol=0.02)


def test_two_parts_of_a_ring_are_one():
    first, second = track_through(ROUND[: int(0.7 * len(ROUND))]), track_through(np.roll(ROUND, 9, axis=0)[::-1][:-20])
    rings = as_rings(lines_of(first, second))
    assert rings is not None and len(rings) == 1


def test_other_lines_stay():
    """A short arc, a straight line, a drop, and a way with corners round a square."""
    square = 5e-3 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [-1.0, -0.9]])
    arc = track_through(ROUND[: len(ROUND) // 3])
    tracks = arc, Track(1e-3 * np.array([[0.0, 0.0], [9.0, 1.0]])), Track(np.zeros((1, 2))), Track(square, (1, 2, 3))
    assert as_rings(lines_of(*tracks)) is None
