"""Pieces of one line, found as such and joined where the image allows it."""

from types import SimpleNamespace

import pytest
import torch

from nets.reconstruct.fibres.image.image_fit import ImageFit
from nets.reconstruct.fibres.search.joins import gaps_between, stacks, unstacked, ways_to_join, whole, with_joins
from nets.reconstruct.fibres.search.line_search import Answer, LineSearch
from tests.nets.reconstruct.exact_light import light_of
from tests.nets.reconstruct.fibres.three_lines import LINES, SCENE, N, error_um, noisy_image
from warp_caustics.prints.model import LineModel
from warp_caustics.reconstruct.base import CausticImage


def cut(line, start, stop):
    """A line without the part between two shares of its length."""
    first, second = line.clone(), line.clone()
    along = line[2:4] - line[:2]
    first[2:4], second[:2] = line[:2] + start * along, line[:2] + stop * along
    return torch.stack([first, second])


@pytest.fixture(scope="module")
def model():
    return LineModel(SCENE)


@pytest.fixture(scope="module")
def fit(model):
    return ImageFit(SCENE, noisy_image(model), model, 2 * N)


def test_a_gap_lies_between_the_pieces_of_a_line():
    pieces = torch.cat([cut(LINES[0], 0.4, 0.5), LINES[1:]])
    (gap,) = gaps_between(pieces)
    along = LINES[0, 2:4] - LINES[0, :2]
    assert gap.pair == (0, 1) and gap.half_m == pytest.approx(0.05 * float(along.norm()))
    torch.testing.assert_close(gap.middle, LINES[0, :2] + 0.45 * along)
    torch.testing.assert_close(whole(pieces[:2]), LINES[0])


@pytest.mark.parametrize(
    "change",
    [
        {"column": 4, "factor": 1.3},
        {"column": 5, "factor": 1.3},
        {"column": 0, "by_m": 3e-3},
    ],
    ids=["wider", "higher", "beside it"],
)
def test_other_lines_are_no_pieces(change):
    pieces = cut(LINES[0], 0.4, 0.5)
    pieces[1, change["column"]] *= change.get("factor", 1.0)
    pieces[1, [0, 2]] += change.get("by_m", 0.0)
    assert gaps_between(pieces) == []
    assert gaps_between(cut(LINES[0], 0.6, 0.4)) == []  # on top of each other


def test_three_pieces_are_one_line():
    first, rest = cut(LINES[0], 0.3, 0.35)
    pieces = torch.stack([first, *cut(rest, 0.5, 0.6)])
    found = whole(pieces[[2, 0, 1]])
    ends = found[:4].reshape(2, 2)
    torch.testing.assert_close(torch.stack(sorted(ends, key=lambda end: float(end[0]))).flatten(), LINES[0, :4])
    torch.testing.assert_close(found[4:], LINES[0, 4:])
    assert {gap.pair for gap in gaps_between(pieces)} >= {(0, 1), (1, 2)}


def test_pieces_with_something_between_become_the_line(model, fit):
    """Of two lines that cross, each in two pieces with a short line in the gap; neither alone is better."""
    filler = torch.tensor([[-2.5e-3, 0.0, 1.5e-3, -0.5e-3, 3e-3, 9e-4]], dtype=torch.float64)
    pieces = torch.cat([cut(LINES[0], 0.42, 0.58), cut(LINES[1], 0.42, 0.58), LINES[2:], filler])
    found = with_joins(fit, pieces)
    assert gaps_between(found.lines) == [] and len(found.lines) <= 4
    assert error_um(model, found.lines) < 0.05 * error_um(model, pieces)
    assert found.loss < 1.2 * fit.loss(model.heights(LINES))


def test_lines_that_end_are_not_joined(model):
    """What the image shows in two pieces stays so."""
    pieces = torch.cat([cut(LINES[0], 0.4, 0.55), LINES[1:]])
    image = CausticImage(light_of(SCENE, model.heights(pieces)).numpy())
    found = with_joins(ImageFit(SCENE, image, model, 2 * N), pieces)
    torch.testing.assert_close(found.lines, pieces)


@pytest.mark.parametrize("stays_explained", [True, False])
def test_a_search_ends_with_whole_lines(model, stays_explained):
    """Pieces that touch explain the image as well as the line does: that is taken, unless more than noise is left."""
    pieces = torch.cat([cut(LINES[0], 0.5, 0.5), LINES[1:]])
    answer = Answer(model.heights(LINES), torch.full((N, N), 1e-6))
    view = SimpleNamespace(is_explained=lambda lines: stays_explained)
    search = LineSearch(SCENE, noisy_image(model), model, 2 * N, jumps=1, answer=answer, view=view)
    search.lines = pieces
    search._join()
    if stays_explained:
        assert len(search.lines) == 3 and error_um(model, search.lines) < 2.0
    else:
        assert search.lines is pieces


def stacked():
    """A line told too low, and two end to end on top of it that make up for the rest."""
    low, (first, second) = LINES[0].clone(), cut(LINES[0], 0.45, 0.47)
    low[5] *= 0.3
    first[5], second[5] = 0.7 * first[5], 0.7 * second[5]
    return torch.stack([low, LINES[1], first, second])


def test_lines_on_top_of_each_other_are_one():
    lines = stacked()
    assert stacks(lines) == [[0, 2, 3]] and not gaps_between(lines[:3])
    line = unstacked(lines[[0, 2, 3]])
    torch.testing.assert_close(line[:5], LINES[0, :5])
    assert float(line[5]) == pytest.approx(float(LINES[0, 5]), rel=0.02)
    ways = [way for way, _ in ways_to_join(lines) if len(way) == 2]
    assert any(torch.equal(way, torch.stack([LINES[1], line])) for way in ways)


def test_lines_beside_or_across_are_no_stack():
    beside = LINES[0].clone()
    beside[[1, 3]] += 1e-3
    assert stacks(torch.stack([LINES[0], beside])) == [] and stacks(LINES) == []
    assert stacks(LINES[:1]) == [] and stacks(LINES[:0]) == [] and gaps_between(LINES[:0]) == []


def test_the_image_takes_one_line_for_a_stack(model):
    printed = LINES[:2]
    shown = light_of(SCENE, model.heights(printed)).numpy()
    fit = ImageFit(SCENE, CausticImage(shown), model, 2 * N)
    found = with_joins(fit, stacked())
    assert len(found.lines) == 2 and error_um(model, found.lines, printed) < 0.5 * error_um(model, stacked(), printed)
