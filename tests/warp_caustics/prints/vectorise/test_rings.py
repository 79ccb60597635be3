"""Lines that are nearly rings."""

import numpy as np
import pytest

from warp_caustics.prints.curves import ring_points
from warp_caustics.prints.smooth_chains import Track, track_through
from warp_caustics.prints.vectorise.curved_lines import CurvedLines
from warp_caustics.prints.vectorise.rings import circle_of, points_of, with_rings

PLATE = (0.05, 0.05)
MIDDLE, RADIUS = (4e-3, -2e-3), 7e-3
ROUND = ring_points(MIDDLE, RADIUS)[:-1]
WIDTH = 1.5e-3
OTHER = Track(1e-3 * np.array([[-20.0, 5.0], [-5.0, 9.0], [10.0, 5.0]]))


def lines_of(*tracks, height=4e-4):
    return CurvedLines(list(tracks), np.tile([WIDTH, height], (len(tracks), 1)))


def part(first, last, points=ROUND):
    """Of a circle, by shares of it."""
    return track_through(points[int(first * len(points)) : int(last * len(points))])


def astray(share, part=0.15):
    """Most of a circle, whose last part goes off on a tangent."""
    kept = ROUND[: int(share * len(ROUND))]
    count = int(part * len(ROUND))
    step = kept[-1] - kept[-2]
    return track_through(np.concatenate([kept, kept[-1] + step * np.arange(1, count)[:, None]]))


def is_on(track, middle=MIDDLE, radius=RADIUS):
    np.testing.assert_allclose(np.hypot(*(track.nodes_m - middle).T), radius, rtol=0.02)
    return True


@pytest.mark.parametrize("share", [0.65, 0.9])
def test_the_circle_is_that_of_most_of_a_way(share):
    middle, radius, aside = circle_of(points_of(astray(share)))
    np.testing.assert_allclose(middle, MIDDLE, atol=5e-5)
    assert radius == pytest.approx(RADIUS, abs=5e-5) and aside < 5e-5


def test_what_is_nearly_a_ring_becomes_one():
    (rings,) = with_rings(lines_of(astray(0.8), OTHER), PLATE)
    assert rings.tracks[0] is OTHER and rings.tracks[1].is_closed and is_on(rings.tracks[1])


def test_two_parts_of_a_ring_are_one():
    first, second = track_through(ROUND[: int(0.7 * len(ROUND))]), track_through(np.roll(ROUND, 9, axis=0)[::-1][:-20])
    (rings,) = with_rings(lines_of(first, second), PLATE)
    assert len(rings) == 1


def test_short_pieces_of_a_ring_are_one_where_they_are_alike():
    """Neither is as long as a ring would have to be; one of another height is none of its pieces."""
    pieces = part(0.0, 0.33), part(0.4, 0.7)
    (rings,) = with_rings(lines_of(*pieces), PLATE)
    assert len(rings) == 1 and rings.tracks[0].is_closed and is_on(rings.tracks[0])
    np.testing.assert_allclose(rings.sizes, [[WIDTH, 4e-4]])
    assert not with_rings(lines_of(pieces[0]).with_more(lines_of(pieces[1], height=8e-4)), PLATE)


def test_what_lies_on_a_ring_is_left_out_in_another_way_to_say_it():
    on_it = lines_of(part(0.9, 0.95), height=1e-3)
    ways = with_rings(lines_of(part(0.0, 0.8), OTHER).with_more(on_it), PLATE)
    assert [len(way) for way in ways] == [3, 2]
    assert ways[1].tracks[0] is OTHER and ways[1].tracks[1].is_closed


def test_of_a_ring_that_leaves_the_plate_there_are_the_arcs_that_it_holds():
    middle, radius = (0.02, 0.0), 0.015
    points = ring_points(middle, radius)[:-1]
    inside = np.flatnonzero(points[:, 0] < 0.024)
    seen = np.roll(points, -int(inside[np.argmax(np.diff(inside, append=inside[0] + len(points)))]) - 1, axis=0)
    seen = seen[seen[:, 0] < 0.022]
    (way,) = with_rings(lines_of(track_through(seen)), PLATE)
    assert [track.is_closed for track in way.tracks] == [False] and is_on(way.tracks[0], middle, radius)
    ends = way.tracks[0].nodes_m[[0, -1]]
    np.testing.assert_allclose(ends[:, 0], PLATE[0] / 2 + WIDTH / 2, atol=4e-4)
    assert ends[0, 1] * ends[1, 1] < 0 and way.tracks[0].nodes_m[:, 0].min() == pytest.approx(0.005, abs=2e-4)


def test_a_circle_across_the_plate_is_two_arcs():
    """It leaves at both sides."""
    points = ring_points((0.0, 0.0), 0.03)[:-1]
    seen = [points[(np.abs(points[:, 0]) < 0.02) & (sign * points[:, 1] > 0)] for sign in (1, -1)]
    plate = (0.045, 0.08)
    (way,) = with_rings(lines_of(*map(track_through, seen)), plate)
    assert len(way) == 2 and not any(track.is_closed for track in way.tracks)
    assert {np.sign(track.nodes_m[len(track.nodes_m) // 2, 1]) for track in way.tracks} == {1, -1}


def test_rings_alone_are_not_said_anew():
    whole = track_through(ROUND, is_closed=True)
    assert not with_rings(lines_of(whole, OTHER), PLATE)
    assert len(with_rings(lines_of(whole, whole), PLATE)[0]) == 1


def test_other_lines_stay():
    """A short arc, a straight line, a drop, and a way with corners round a square."""
    square = 5e-3 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [-1.0, -0.9]])
    arc = track_through(ROUND[: len(ROUND) // 3])
    tracks = arc, Track(1e-3 * np.array([[0.0, 0.0], [9.0, 1.0]])), Track(np.zeros((1, 2))), Track(square, (1, 2, 3))
    assert not with_rings(lines_of(*tracks), PLATE)
