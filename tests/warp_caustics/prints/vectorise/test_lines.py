"""A relief back to the lines it was made of."""

import numpy as np
import pytest
import torch
from scipy import ndimage

from data_gen.config import ReliefConfig
from data_gen.dataset_config import sample_generator
from data_gen.patterns import draw_strokes
from warp_caustics.prints.fit import fit_lines
from warp_caustics.prints.line_shape import Shape
from warp_caustics.prints.model import LineModel
from warp_caustics.prints.vectorise import lines_of_relief
from warp_caustics.prints.vectorise.moves import LineSet, joined_line
from warp_caustics.prints.vectorise.proposals import proposed_lines
from warp_caustics.scene import Scene

SCENE = Scene(height_samples=64, image_pixels=64)
MODEL = LineModel(SCENE)
LINES = 1e-3 * torch.tensor(
    [[-15.0, -12.0, 14.0, 9.0, 3.0, 0.8], [-9.0, 15.0, 10.0, -16.0, 2.2, 1.2], [-18.0, 5.0, 17.0, 15.0, 3.6, 0.5]],
    dtype=torch.float64,
)


def relief_of(lines):
    return MODEL.heights(lines)


def error_um(lines, relief):
    return 1e6 * float((relief_of(lines) - relief).square().mean().sqrt())


def ordered(lines):
    """Ends in a fixed order, lines by their first end."""
    rows = [row if tuple(row[:2]) < tuple(row[2:4]) else [*row[2:4], *row[:2], *row[4:]] for row in lines.tolist()]
    return np.array(sorted(rows))


@pytest.fixture(autouse=True)
def one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.mark.parametrize("shape", [Shape(), Shape(0.5), Shape(1.0, 1.0), Shape(0.5, 1.0)])
def test_exact_relief_gives_its_lines_back(shape):
    model = LineModel(SCENE)
    model.shape = shape
    relief = model.heights(LINES)
    found = lines_of_relief(model, relief, torch.zeros(64, 64))
    assert len(found) == 3
    np.testing.assert_allclose(ordered(found), ordered(LINES), atol=2e-5)
    assert 1e6 * float((model.heights(found) - relief).square().mean().sqrt()) < 0.5


def test_a_line_of_any_section_is_proposed_about_as_wide_as_it_is():
    """The width at half the height is a ridge's; the full one follows from the section."""
    for shape in (Shape(), Shape(0.5), Shape(1.0, 1.0), Shape(0.5, 1.0)):
        model = LineModel(SCENE)
        model.shape = shape
        proposed = proposed_lines(model.heights(LINES[:1]).double().numpy(), SCENE.plate_size_m, 1, shape)
        assert proposed[0, 4] == pytest.approx(float(LINES[0, 4]), rel=0.3)


def test_places_that_are_wrong_and_said_to_be_uncertain_do_no_harm():
    relief, spread = relief_of(LINES), torch.full((64, 64), 2e-6)
    wrong = relief.clone()
    wrong[14:19, 14:20] += 2e-4
    wrong[40:46, 30:36] *= 0.4
    changed = (wrong - relief).abs() > 0
    spread[changed] = 2e-4
    found = lines_of_relief(MODEL, wrong, spread)
    before = 1e6 * float((wrong - relief).square().mean().sqrt())
    assert before > 20 and error_um(found, relief) < 2.0


def test_random_fields_of_the_paper():
    """At half its resolution; few lines, so that it takes a second."""
    config, errors = ReliefConfig(line_count=(3, 6), line_width_m=(1e-3, 4e-3)), []
    for sample in range(4):
        strokes = draw_strokes(config, sample_generator("5" * 64, "relief", sample))
        lines = torch.from_numpy(strokes[:, 1:])
        relief = relief_of(lines)
        found = lines_of_relief(MODEL, relief, torch.zeros(64, 64))
        errors.append(error_um(found, relief))
    assert np.median(errors) < 1.0, errors


def test_nothing_printed():
    assert len(lines_of_relief(MODEL, torch.zeros(64, 64), torch.zeros(64, 64))) == 0
    noise = 1e-6 * torch.randn(64, 64, generator=torch.Generator().manual_seed(0))
    assert len(lines_of_relief(MODEL, noise, torch.full((64, 64), 1e-6))) == 0


def test_most_lines():
    assert len(lines_of_relief(MODEL, relief_of(LINES), torch.zeros(64, 64), most=2)) <= 2


def test_fit_moves_only_what_it_may():
    off = LINES + 2e-4
    sigma = torch.full((64, 64), 5e-5)
    found, loss = fit_lines(MODEL, off, relief_of(LINES), sigma, only=[1])
    assert torch.equal(found[[0, 2]], off[[0, 2]]) and not torch.equal(found[1], off[1])
    all_found, least = fit_lines(MODEL, off, relief_of(LINES), sigma, iterations=60)
    assert least < loss and least < 1e-3
    np.testing.assert_allclose(all_found.numpy(), LINES.numpy(), atol=2e-5)


def test_a_line_cut_in_two_is_one_again():
    p = LINES[0]
    middle = (p[:2] + p[2:4]) / 2
    halves = torch.stack([torch.cat([p[:2], middle, p[4:]]), torch.cat([middle, p[2:4], p[4:]])])
    lines = LineSet(MODEL, relief_of(LINES), torch.zeros(64, 64))
    lines.lines = torch.cat([halves, LINES[1:]])
    lines.focus(1e-5)
    lines.merge()
    assert len(lines.lines) == 3 and error_um(lines.lines, relief_of(LINES)) < 1.0


def test_a_line_too_many_is_removed():
    lines = LineSet(MODEL, relief_of(LINES), torch.zeros(64, 64))
    copy = LINES[:1].clone()
    copy[0, 5] = 2e-5
    lines.lines = torch.cat([LINES, copy])
    lines.focus(1e-5)
    lines.prune()
    assert len(lines.lines) == 3


def test_lines_that_do_not_continue_each_other_stay_apart():
    a, b = 1e-3 * np.array([[0.0, 0.0, 5.0, 0.0, 1.0, 0.5], [6.0, 0.0, 9.0, 0.0, 1.2, 0.7]])
    aside, bent, away = 1e-3 * np.array(
        [[0.0, 2.0, 0.0, 2.0, 0.0, 0.0], [0.0, 0.0, 0.0, 4.0, 0.0, 0.0], [8.0, 0.0, 8.0, 0.0, 0.0, 0.0]]
    )
    joined = joined_line(a, b)
    assert sorted([joined[0], joined[2]]) == pytest.approx([0.0, 9e-3])
    assert 1e-3 < joined[4] < 1.2e-3 and 5e-4 < joined[5] < 7e-4
    assert joined_line(a, b + aside) is None
    assert joined_line(a, b + bent) is None
    assert joined_line(a, b + away) is None


def test_ridges_of_one_length_are_proposed_in_one_order_whatever_the_size_of_a_cell():
    """Ties were broken by rounding where a cell's size is no short binary number, and fits went other ways."""
    residual = 1e-4 * ndimage.gaussian_filter(np.random.default_rng(4).standard_normal((64, 64)), 2)
    ends = [proposed_lines(residual, (size, size), 8)[:, :4] / size for size in (0.05, 0.0625, 0.07)]
    for others in ends[1:]:
        np.testing.assert_allclose(others, ends[0], atol=1e-12)
