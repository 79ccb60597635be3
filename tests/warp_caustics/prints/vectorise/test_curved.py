"""Lines with corners and curves from the relief they were printed with."""

import numpy as np
import pytest
import torch

from warp_caustics.prints.curves import bezier_points, meander_points, ring_points
from warp_caustics.prints.model import LineModel
from warp_caustics.prints.paths import paths_relief, uniform_path
from warp_caustics.prints.smooth_chains import Track, track_through
from warp_caustics.prints.vectorise.curved import curved_lines_of_relief, refitted_curves
from warp_caustics.prints.vectorise.curved_ends import cuts, joined_tracks, meetings
from warp_caustics.prints.vectorise.curved_lines import CurvedLines, penalty_of
from warp_caustics.prints.vectorise.curved_set import CurvedSet
from warp_caustics.prints.vectorise.ridges import circles_of, ridges_of
from warp_caustics.scene import Scene

SCENE = Scene(height_samples=96, image_pixels=96)
CURVE = bezier_points(1e-3 * np.array([[-20.0, -12.0], [-5.0, 22.0], [8.0, -25.0], [20.0, 15.0]]))
ACROSS = 1e-3 * np.array([[-18.0, 10.0], [19.0, -8.0]])
MEANDER = meander_points((1e-3, 2e-3), 2e-2, 4e-3, 4, 0.4)
RING = ring_points((2e-3, -1e-3), 9e-3)
CORNERS = 1e-3 * np.array([[-15.0, -10.0], [-13.0, 9.0], [8.0, 12.0], [14.0, -8.0]])


def relief_of(*paths):
    """Of ways with widths and heights [mm]."""
    printed = [uniform_path(way, 1e-3 * width, 1e-3 * height) for way, width, height in paths]
    return torch.from_numpy(paths_relief(printed, SCENE.height_samples, SCENE.plate_size_m).astype(np.float32))


def found_in(relief):
    model = LineModel(SCENE)
    lines = curved_lines_of_relief(model, relief, torch.zeros_like(relief))
    shown = CurvedSet(model, relief, torch.zeros_like(relief))
    shown.begin(lines)
    return lines, 1e6 * float((model.joined(shown.state.parts) - relief).square().mean().sqrt())


@pytest.mark.parametrize(
    ("paths", "count", "error_um"),
    [
        (((CURVE, 2.0, 0.5), (ACROSS, 1.4, 0.3)), 2, 1.0),
        (((MEANDER, 1.5, 0.4),), 1, 1.0),
        (((RING, 2.5, 0.6), (ACROSS, 1.4, 0.3)), 2, 1.0),
        (((CORNERS, 2.0, 0.5),), 1, 1.5),
    ],
    ids=["crossing curves", "meander", "ring", "corners"],
)
def test_lines_are_those_that_were_printed(paths, count, error_um):
    """As many, as wide and high, each whole: through crossings, round turns and corners."""
    lines, off_um = found_in(relief_of(*paths))
    assert len(lines) == count and off_um < error_um
    sizes = lines.sizes[np.argsort(lines.sizes[:, 1])]
    expected = 1e-3 * np.array(sorted(([width, height] for _, width, height in paths), key=lambda size: size[1]))
    np.testing.assert_allclose(sizes, expected, rtol=0.03)


def test_a_ring_is_closed():
    lines, _ = found_in(relief_of((RING, 2.5, 0.6)))
    assert [track.is_closed for track in lines.tracks] == [True]


def test_an_empty_plate_has_no_lines():
    lines, off_um = found_in(torch.zeros(96, 96))
    assert len(lines) == 0 and off_um == 0


def test_ridges_go_straight_on_where_others_lie_on_top():
    ridges = ridges_of(relief_of((CURVE, 2.0, 0.5), (ACROSS, 1.4, 0.3)).double().numpy(), 1.5e-5)
    lengths = [ridge.length * SCENE.sample_pitch_m[0] for ridge in ridges]
    curve = np.hypot(*np.diff(CURVE, axis=0).T).sum()
    assert lengths[0] == pytest.approx(curve, rel=0.1)
    assert sorted(lengths)[-2] > 0.7 * np.hypot(*(ACROSS[1] - ACROSS[0]))


def test_a_part_of_a_ring_tells_its_circle():
    turns = RING[: len(RING) // 3]
    ridges = ridges_of(relief_of((turns, 1.5, 0.4)).double().numpy(), 1.5e-5)
    places = [ridge.points.mean(axis=0) for ridge in circles_of(ridges[:1])]
    centre = np.array([2e-3, -1e-3]) / SCENE.sample_pitch_m[0] + 47.5
    assert places and np.hypot(*(places[0] - centre)) < 1.5


def test_ends_that_meet_are_joined():
    """With a corner where both ways cross when they are drawn on; only lines that are alike."""
    one, other = (
        Track(1e-3 * np.array([[0.0, 0.0], [2.0, 0.0], [4.0, 0.0]])),
        Track(1e-3 * np.array([[4.2, 0.3], [4.2, 4.0]])),
    )
    sharp, smooth = joined_tracks(one, -1, other, 0)
    assert sharp.corners == (2,) and smooth.corners == ()
    np.testing.assert_allclose(sharp.nodes_m[2], [4.2e-3, 0.0], atol=1e-12)
    alike = CurvedLines([one, other], 1e-3 * np.array([[1.0, 0.3], [1.05, 0.31]]))
    assert [pair.lines for pair in meetings(alike)] == [(0, 1)]
    assert not meetings(CurvedLines([one, other], 1e-3 * np.array([[1.0, 0.3], [2.0, 0.31]])))
    # Backwards it is the same line.
    back = joined_tracks(other, 0, one, -1)[0]
    np.testing.assert_allclose(back.nodes_m[::-1], sharp.nodes_m, atol=1e-12)


def test_lines_are_cut_in_two():
    track = Track(np.linspace([0.0, 0.0], [1e-2, 0.0], 20), (5, 12))
    found = cuts(track, 6)
    assert len({len(first.nodes_m) for first, _ in found}) == 6
    for first, second in found:
        np.testing.assert_array_equal(np.concatenate([first.nodes_m, second.nodes_m[1:]]), track.nodes_m)
        corners = [*first.corners, *(k + len(first.nodes_m) - 1 for k in second.corners)]
        assert set(corners) <= {5, 12} and len(first.nodes_m) > 3 < len(second.nodes_m)
    assert not cuts(Track(track.nodes_m[:8]), 6)


def test_what_saves_too_little_is_removed():
    relief = relief_of((CURVE, 2.0, 0.5))
    lines, _ = found_in(relief)
    few = CurvedSet(LineModel(SCENE), relief, torch.full_like(relief, 1e-5))
    idle = CurvedLines([Track(1e-3 * np.array([[-20.0, 20.0], [-16.0, 20.0]]))], np.array([[5e-4, 1.1e-5]]))
    few.begin(lines.with_more(idle))
    few.focus(3e-5)
    assert few.prune() and len(few.lines) == 1
    assert penalty_of(lines.tracks[0]) > penalty_of(idle.tracks[0])


def test_lines_that_are_nearly_right_are_moved():
    relief = relief_of((CURVE, 2.0, 0.5), (ACROSS, 1.4, 0.3))
    lines, _ = found_in(relief)
    rng = np.random.default_rng(0)
    tracks = [track.at(track.nodes_m + 5e-5 * rng.standard_normal(track.nodes_m.shape)) for track in lines.tracks]
    moved, left = refitted_curves(LineModel(SCENE), CurvedLines(tracks, 1.1 * lines.sizes), relief, 0 * relief)
    np.testing.assert_allclose(moved.sizes, lines.sizes, rtol=0.02)
    assert left < 100


def begun_with(relief, *lines):
    """A set that has these lines: nodes [m], and size [mm]."""
    found = CurvedSet(LineModel(SCENE), relief, torch.zeros_like(relief))
    found.focus(3e-5)
    tracks = [track_through(np.asarray(way)) for way, *_ in lines]
    found.begin(CurvedLines(tracks, 1e-3 * np.array([size for _, *size in lines])))
    found.refit(20)
    return found


def test_ways_that_went_astray_are_followed_anew():
    """Two crossing lines, each of which turns into the other where they cross."""
    one, other = 1e-3 * np.array([[[-18.0, -8.0], [18.0, 8.0]], [[-18.0, 8.0], [18.0, -8.0]]])
    relief = relief_of((one, 2.0, 0.5), (other, 2.0, 0.3))
    middle = np.zeros(2)
    below = np.concatenate([np.linspace(one[0], middle, 20), np.linspace(middle, other[1], 20)[1:]])
    above = np.concatenate([np.linspace(other[0], middle, 20), np.linspace(middle, one[1], 20)[1:]])
    found = begun_with(relief, (below, 2.0, 0.4), (above, 2.0, 0.4))
    before = found.state.loss
    assert found.rebuild(10)
    found.refit(30)
    assert found.state.loss < 0.1 * before
    assert len(found.lines) == 2
    np.testing.assert_allclose(np.sort(found.lines.sizes[:, 1]), [3e-4, 5e-4], rtol=0.03)
    for track in found.lines.tracks:
        ends = track.nodes_m[[0, -1]]
        assert abs(float(ends.sum())) < 2e-3  # straight through the middle


@pytest.mark.parametrize("share", [0.38, 0.62])
def test_a_way_over_two_lines_is_cut(share):
    """Two lines in a row of different sizes, told as one: at no quarter of it, whichever end is the longer."""
    start, middle, end = 1e-3 * np.array([[-18.0, 2.0], [-18.0 + 36.0 * share, 2.0], [18.0, 2.0]])
    relief = relief_of((np.stack([start, middle]), 2.0, 0.6), (np.stack([middle, end]), 1.4, 0.3))
    found = begun_with(relief, (np.linspace(start, end, 40), 1.7, 0.45))
    before = found.state.loss
    assert found.split(10)
    found.refit(40)
    assert found.state.loss < 0.2 * before
    np.testing.assert_allclose(found.lines.sizes, 1e-3 * np.array([[2.0, 0.6], [1.4, 0.3]]), rtol=0.06)


def test_a_way_that_goes_on_along_another_line_ends_there():
    """A long way, whose last part lies on a line of its own that is told lower than it is: both tell the relief well."""
    other = 1e-3 * np.array([[-16.0, -12.0], [17.0, -8.0]])
    relief = relief_of((ACROSS, 1.4, 0.3), (other, 1.5, 0.7))
    astray = np.concatenate([np.linspace(ACROSS[0], ACROSS[1], 40), np.linspace(other[1], other[0], 40)])
    found = begun_with(relief, (astray, 1.4, 0.3), (np.linspace(*other, 40), 1.5, 0.4))
    before = found.worth
    assert found.unstack() and not found.unstack()
    found.refit(30)
    assert found.worth < before and len(found.lines) == 2
    np.testing.assert_allclose(np.sort(found.lines.sizes[:, 1]), [3e-4, 7e-4], rtol=0.05)


def test_lines_that_cross_are_not_one_on_the_other():
    found = begun_with(relief_of((CURVE, 2.0, 0.5), (ACROSS, 1.4, 0.3)), (CURVE, 2.0, 0.5), (ACROSS, 1.4, 0.3))
    assert not found.unstack() and len(found.lines) == 2


def test_nothing_is_cut_or_followed_anew_where_lines_are_right():
    relief = relief_of((CURVE, 2.0, 0.5))
    found = begun_with(relief, (CURVE, 2.0, 0.5))
    state = found.state
    assert not found.split(10) and not found.rebuild(10)
    assert found.state is state
