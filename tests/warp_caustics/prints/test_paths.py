"""Lines along points: closed forms, corners and crossings, and the kernel against float64."""

import math
from itertools import pairwise

import numpy as np
import pytest
import torch

from warp_caustics.errors import InputError
from warp_caustics.prints.chains import chains_of, rows_of
from warp_caustics.prints.curves import bezier_points, meander_points, ring_points
from warp_caustics.prints.font import text_lines
from warp_caustics.prints.line import Line, line_relief
from warp_caustics.prints.path_kernels import BLOCK, PATH_TRAIT_COLUMNS
from warp_caustics.prints.path_printer import block_boxes, print_paths
from warp_caustics.prints.paths import MAX, SUM, PrintedPath, path_of_line, paths_relief, uniform_path
from warp_caustics.prints.rows import RING, SEGMENT
from warp_caustics.prints.sections import KINDS, named_section
from warp_caustics.scene import Scene

SCENE = Scene(height_samples=48, image_pixels=96)
PLATE = SCENE.plate_size_m
LINES = [Line((-0.02, -0.01), (0.015, 0.012), 3e-3, 5e-4), Line((0.0, -0.02), (0.004, 0.03), 1e-3, 8e-4)]
CAP = named_section("cap", contact_angle_rad=1.1)
SECTIONS = [
    CAP,
    named_section("cap", contact_angle_rad=math.pi / 2),
    named_section("cosine"),
    named_section("quarter"),
    named_section("ellipse"),
    named_section("parabola", exponent=1.4),
    named_section("gaussian", reach=1.7),
]


def trait_row(section, merging=SUM, bow=(0.0, 0.0, 0.0), wave=(0.0, 0.0, 0.0, 0.0)):
    row = (KINDS.index(section.kind), section.parameter, section.reach, merging, *bow, *wave)
    assert len(row) == len(PATH_TRAIT_COLUMNS)
    return torch.tensor([row], dtype=torch.float32)


def kernel(chains, section, merging=SUM, device="cpu", **traits):
    rows = torch.tensor(rows_of(chains)[None], dtype=torch.float32, device=device)
    return print_paths(rows, SCENE, trait_row(section, merging, **traits))[0].double().cpu().numpy()


def paths(chains, section):
    ends = np.append(chains.first, len(chains.points_m))
    return [
        PrintedPath(chains.points_m[a:b], chains.widths_m[a:b], chains.heights_m[a:b], section)
        for a, b in pairwise(ends)
    ]


SHAPES = {
    "lines": [np.array([line.start_m, line.end_m]) for line in LINES],
    "polyline": [np.array([[-0.02, 0.0], [0.0, 0.015], [0.002, -0.02], [0.03, 0.01]])],
    "curve": [bezier_points(np.array([[-0.02, -0.02], [0.0, 0.04], [0.01, -0.04], [0.02, 0.02]]))],
    "meander": [meander_points((0.001, 0.002), 0.02, 3e-3, 5, 0.4)],
    "ring": [ring_points((0.002, -0.003), 0.015)],
    "drops": [np.array([[0.01, 0.0]]), np.array([[-0.024, 0.02]]), np.array([[0.0105, 0.0005]])],
    "text": text_lines("AB 0\n8?", 0.012, (0.0, 0.0), 0.3),
}


@pytest.mark.parametrize("merging", [SUM, 3.0, 45.0, MAX])
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("section", SECTIONS, ids=lambda s: f"{s.kind}-{s.parameter:.2g}")
def test_the_kernel_prints_what_float64_prints(shape, section, merging):
    """Every shape, section and overlap, thickness changing along the way: within 10 nm, 1 um where an edge is upright."""
    lines = SHAPES[shape]
    rng = np.random.default_rng(1)
    chains = chains_of(lines, np.full(len(lines), 2e-3), np.full(len(lines), 6e-4))
    factor = rng.uniform(0.7, 1.3, len(chains.points_m))
    chains = type(chains)(chains.points_m, chains.widths_m * factor, chains.heights_m * factor, chains.first)
    expected = paths_relief(paths(chains, section), 48, PLATE, merging=merging)
    assert expected.max() > 1e-4
    is_upright = section.foot_angle_rad(1.0, 1.0) == math.pi / 2
    np.testing.assert_allclose(kernel(chains, section, merging), expected, rtol=0, atol=1e-6 if is_upright else 1e-8)


@pytest.mark.gpu
@pytest.mark.parametrize("merging", [SUM, 3.0, MAX])
@pytest.mark.parametrize("shape", SHAPES)
def test_the_kernel_on_a_gpu(shape, merging, device):
    lines = SHAPES[shape]
    chains = chains_of(lines, np.full(len(lines), 2e-3), np.full(len(lines), 6e-4))
    expected = paths_relief(paths(chains, CAP), 48, PLATE, merging=merging)
    np.testing.assert_allclose(kernel(chains, CAP, merging, device), expected, rtol=0, atol=5e-8)


def test_straight_lines_are_those_of_the_line_model():
    """Raised cosines added up: the model that lines are fitted with."""
    relief = paths_relief([path_of_line(line) for line in LINES], 64, PLATE)
    np.testing.assert_allclose(relief, line_relief(LINES, 64, PLATE), atol=1e-15)


def test_without_chains_it_is_the_same():
    """The faster kernel for lines of one row each, rings among them."""
    rows = torch.tensor(
        [
            [
                [SEGMENT, -0.02, -0.01, 0.02, 0.0, 2e-3, 5e-4],
                [RING, 0.0, 0.0, 0.01, 0.0, 1e-3, 3e-4],
                [SEGMENT, 0.01, 0.01, 0.01, 0.01, 4e-3, 2e-4],
            ]
        ]
    )
    both = [print_paths(rows, SCENE, trait_row(CAP), has_chains=chains)[0].numpy() for chains in (True, False)]
    np.testing.assert_allclose(*both, rtol=0, atol=1e-10)
    ring = paths_relief([uniform_path(ring_points((0.0, 0.0), 0.01), 1e-3, 3e-4, CAP)], 48, PLATE)
    alone = print_paths(rows[:, 1:2], SCENE, trait_row(CAP), has_chains=False)[0].double().numpy()
    np.testing.assert_allclose(alone, ring, rtol=0, atol=2e-6)


def test_corners_and_crossings_of_one_line_are_not_doubled():
    """A closed square with a diagonal: nowhere higher than its crown; as two lines it is, where they cross."""
    there, back = np.array([[-0.01, -0.01], [0.01, 0.01]]), np.array([[0.01, -0.01], [-0.01, 0.01]])
    one = uniform_path(np.concatenate([there, back]), 2e-3, 5e-4, CAP)
    assert paths_relief([one], 100, PLATE).max() <= 5e-4
    two = [uniform_path(part, 2e-3, 5e-4, CAP) for part in (there, back)]
    assert paths_relief(two, 101, PLATE).max() > 0.9e-3
    assert paths_relief(two, 101, PLATE, merging=MAX).max() <= 5e-4
    merged = paths_relief(two, 101, PLATE, merging=2.0).max()
    assert 6.5e-4 < merged <= math.sqrt(2) * 5e-4


def test_turned_and_mirrored_prints():
    """A quarter turn of the lines turns the relief; a mirror mirrors it."""
    points = SHAPES["curve"][0]
    relief = paths_relief([uniform_path(points, 2e-3, 4e-4, CAP)], 50, PLATE)
    turned = paths_relief([uniform_path(points @ np.array([[0, 1], [-1, 0]]), 2e-3, 4e-4, CAP)], 50, PLATE)
    np.testing.assert_allclose(turned, np.rot90(relief, -1), atol=1e-12)
    mirrored = paths_relief([uniform_path(points * (-1, 1), 2e-3, 4e-4, CAP)], 50, PLATE)
    np.testing.assert_allclose(mirrored, relief[:, ::-1], atol=1e-12)


def test_volume_of_a_ring():
    """Area of the section times the way of its centre (Pappus)."""
    ring = uniform_path(ring_points((0.001, -0.002), 0.015), 2e-3, 5e-4, CAP)
    volume = paths_relief([ring], 128, PLATE).sum() * (0.05 / 128) ** 2
    assert volume == pytest.approx(CAP.area_m2(2e-3, 5e-4) * 2 * math.pi * 0.015, rel=2e-4)


def test_bands_do_not_show(monkeypatch):
    """However many rows are looked at together."""
    whole = paths_relief(paths(chains_of(SHAPES["text"], [1e-3] * 9, [3e-4] * 9), CAP), 40, PLATE)
    monkeypatch.setattr("warp_caustics.prints.paths._BAND_POINTS", 1)
    banded = paths_relief(paths(chains_of(SHAPES["text"], [1e-3] * 9, [3e-4] * 9), CAP), 40, PLATE)
    np.testing.assert_array_equal(whole, banded)


def test_bow_and_wave_of_the_base():
    """On a bare plate, at the cells' centres."""
    bare = torch.zeros(1, 1, 7)
    k, (x, y) = 2 * math.pi / 0.02, np.meshgrid(*2 * [(np.arange(48) - 23.5) / 48 * 0.05])
    row = trait_row(CAP, bow=(2e-2, -1e-2, 3e-2), wave=(5e-6, k, 0.5 * k, 0.7))
    found = print_paths(bare, SCENE, row)[0].double().numpy()
    expected = 2e-2 * x**2 - 1e-2 * x * y + 3e-2 * y**2 + 5e-6 * np.sin(k * x + 0.5 * k * y + 0.7)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10)


def test_work_of_a_cell_does_not_grow_with_far_pieces():
    """Counted, not timed: of a text of hundreds of rows a cell looks at the rows of a few blocks."""
    lines = text_lines("ABCDEFGH\n01234567", 6e-3)
    rows = torch.tensor(rows_of(chains_of(lines, [5e-4] * len(lines), [2e-4] * len(lines)))[None])
    boxes = block_boxes(rows.float(), torch.ones(1))[0].double().numpy()
    assert len(boxes) == -(-rows.shape[1] // BLOCK) > 40
    x = ((np.arange(128) + 0.5) / 128 - 0.5) * 0.05
    half = 0.05 / 256
    touched = sum(
        (
            (x[None, :] + half >= low_x)
            & (x[None, :] - half <= high_x)
            & (x[:, None] + half >= low_y)
            & (x[:, None] - half <= high_y)
        ).astype(int)
        for low_x, low_y, high_x, high_y, _ in boxes
    )
    assert touched.mean() < 0.05 * len(boxes)
    # And nothing is lost by it: no row reaches over its box.
    for k, row in enumerate(rows[0].numpy()):
        box = boxes[k // BLOCK]
        if row[0] != 3.0:
            ends = np.array([[row[1], row[2]], [row[3], row[4]]])
            assert (ends.min(axis=0) - row[5] / 2 >= box[:2] - 1e-8).all()
            assert (ends.max(axis=0) + row[5] / 2 <= box[2:4] + 1e-8).all()


def test_what_is_no_path_is_refused():
    for points, widths, heights in (
        (np.zeros((0, 2)), np.zeros(0), np.zeros(0)),
        (np.zeros((2, 3)), np.ones(2), np.ones(2)),
        (np.zeros((2, 2)), np.ones(1), np.ones(2)),
        (np.zeros((2, 2)), np.zeros(2), np.ones(2)),
        (np.zeros((2, 2)), np.ones(2), -np.ones(2)),
        (np.full((2, 2), np.nan), np.ones(2), np.ones(2)),
    ):
        with pytest.raises(InputError):
            PrintedPath(points, widths, heights)
    line = [path_of_line(LINES[0])]
    with pytest.raises(InputError, match="merging 0.5 is below 1"):
        paths_relief(line, 16, PLATE, merging=0.5)
    with pytest.raises(InputError, match="supersampling 0"):
        paths_relief(line, 16, PLATE, supersampling=0)
    with pytest.raises(InputError, match="traits have shape"):
        print_paths(torch.zeros(2, 1, 7), SCENE, torch.zeros(2, 7))
    with pytest.raises(InputError, match="rows are torch.float64"):
        print_paths(torch.zeros(1, 1, 7, dtype=torch.float64), SCENE, trait_row(CAP))
