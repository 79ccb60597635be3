"""Ways told by few nodes."""

import numpy as np
import pytest

from warp_caustics.prints.curves import ring_points
from warp_caustics.prints.smooth_chains import STEP_M, Track, TrackPoints, spline_weights, track_through, track_weights


@pytest.mark.parametrize(
    ("nodes", "is_closed"), [(1, False), (2, False), (3, False), (4, False), (9, False), (8, True)]
)
def test_points_are_means_of_nodes(nodes, is_closed):
    weights = spline_weights(nodes, 50, is_closed=is_closed)
    assert weights.shape == (50, nodes) and (weights >= 0).all()
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-12)
    if is_closed:
        np.testing.assert_allclose(weights[0], weights[-1], atol=1e-12)
    elif nodes > 1:
        assert weights[0, 0] == weights[-1, -1] == 1.0


def test_a_straight_way_stays_straight():
    track = track_through(np.linspace([0.0, 0.0], [8e-3, 4e-3], 30))
    points = track_weights(track) @ track.nodes_m
    np.testing.assert_allclose(points[:, 1], points[:, 0] / 2, atol=1e-12)
    assert np.hypot(*np.diff(points, axis=0).T).max() < 1.6 * STEP_M
    assert track.length_m == pytest.approx(np.hypot(8e-3, 4e-3))


def test_a_ring_is_told_by_few_nodes():
    """Of a radius of 4 mm to a micrometre, wherever its first point is."""
    ring = ring_points((1e-3, -2e-3), 4e-3)[:-1]
    for first in (0, 7):
        track = track_through(np.roll(ring, first, axis=0), is_closed=True)
        points = track_weights(track) @ track.nodes_m
        np.testing.assert_allclose(points[0], points[-1], atol=1e-12)
        radii = np.hypot(*(points - [1e-3, -2e-3]).T)
        assert len(track.nodes_m) < 35 and np.abs(radii - 4e-3).max() < 1e-6


def test_a_corner_stays_sharp():
    nodes = 1e-3 * np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [2.0, 1.0], [2.0, 2.0]])
    sharp, smooth = Track(nodes, (2,)), Track(nodes)
    for track, nearest in ((sharp, 0.0), (smooth, 2e-4)):
        points = track_weights(track) @ nodes
        np.testing.assert_allclose(points[[0, -1]], nodes[[0, -1]], atol=1e-15)
        assert np.hypot(*(points - nodes[2]).T).min() >= nearest
    assert np.abs((track_weights(sharp) @ nodes)[:, 0] - 2e-3).min() == 0


def test_gradients_go_back_to_nodes():
    """The adjoint of an affine map: both inner products are the same, filled up points and all."""
    ring = track_through(ring_points((0.0, 0.0), 3e-3)[:-1], is_closed=True)
    tracks = [ring, Track(1e-3 * np.eye(2)), Track(np.zeros((1, 2)))]
    points = TrackPoints(tracks)
    rng = np.random.default_rng(0)
    nodes, by_point = rng.standard_normal(points.nodes_m.shape), rng.standard_normal((3, points.most, 2))
    assert float((points.of(nodes) * by_point).sum()) == pytest.approx(float((points.back(by_point) * nodes).sum()))
    moved = points.tracks_at(nodes)
    assert [len(track.nodes_m) for track in moved] == [len(track.nodes_m) for track in tracks]
    assert moved[0].is_closed and not moved[1].is_closed
