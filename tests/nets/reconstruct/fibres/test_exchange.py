"""The better of two searches in each place."""

import pytest
import torch

from nets.reconstruct.fibres.image.image_fit import ImageFit
from nets.reconstruct.fibres.search.exchange import exchanged, rivals
from nets.reconstruct.fibres.search.line_search import LineSearch
from tests.nets.reconstruct.fibres.three_lines import LINES, SCENE, N, error_um, noisy_image
from warp_caustics.prints.model import LineModel


@pytest.fixture(scope="module")
def model():
    return LineModel(SCENE)


@pytest.fixture(scope="module")
def image(model):
    return noisy_image(model)


def beside(line, by_m=1.8e-3):
    """A line moved sideways by less than its width."""
    moved = line.clone()
    along = (line[2:4] - line[:2]) / (line[2:4] - line[:2]).norm()
    moved[:4] += by_m * torch.stack([-along[1], along[0]]).repeat(2)
    return moved


def test_lines_that_differ_are_rivals_of_those_in_their_place(model):
    mine = torch.stack([LINES[0], beside(LINES[1]), LINES[2]])
    theirs = torch.stack([beside(LINES[2]), LINES[0], LINES[1]])
    found = rivals(model.parts(mine)[0], model.parts(theirs)[0])
    assert sorted((sorted(group.mine), sorted(group.theirs)) for group in found) == [([1], [2]), ([2], [0])]


def test_what_only_one_has_stands_alone(model):
    found = rivals(model.parts(LINES)[0], model.parts(LINES[:2])[0])
    assert [(group.mine, group.theirs) for group in found] == [([2], [])]
    assert rivals(model.parts(LINES)[0], model.parts(LINES.flip(0))[0]) == []


def test_the_better_of_each_is_taken(model, image):
    """Either search has one line right that the other has wrong, and one misses the third."""
    fit = ImageFit(SCENE, image, model, 2 * N)
    mine, theirs = torch.stack([LINES[0], beside(LINES[1])]), torch.stack([beside(LINES[0]), LINES[1], LINES[2]])
    found = exchanged(fit, mine, theirs)
    assert len(found.lines) == 3 and error_um(model, found.lines) < 2.0
    assert found.loss < 1.2 * fit.loss(model.heights(LINES))


def test_right_lines_are_not_exchanged(model, image):
    fit = ImageFit(SCENE, image, model, 2 * N)
    torch.testing.assert_close(exchanged(fit, LINES, torch.stack([beside(line) for line in LINES])).lines, LINES)


def test_a_search_begins_with_the_better_of_both(model, image):
    mine, theirs = torch.stack([LINES[0], beside(LINES[1], 4e-3), LINES[2]]), LINES[1:]
    search = LineSearch(SCENE, image, model, 2 * N, jumps=0, others=theirs)
    assert error_um(model, search.run(mine)) < 1.0
    alone = LineSearch(SCENE, image, model, 2 * N, jumps=0, iterations=5)
    assert error_um(model, alone.run(mine)) > 5.0
