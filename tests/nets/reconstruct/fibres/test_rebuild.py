"""Places where lines explain the image worst, built anew, on a small scene."""

import math

import numpy as np
import pytest
import torch

from nets.reconstruct.fibres.image.image_fit import ImageFit
from nets.reconstruct.fibres.image.lines_view import LinesView
from nets.reconstruct.fibres.image.on_others import descended
from nets.reconstruct.fibres.search.clearing import clearings, cut_back, reaching, within
from nets.reconstruct.fibres.search.line_search import Answer, LineSearch
from nets.reconstruct.fibres.search.moves import stretched
from nets.reconstruct.fibres.search.rebuild import rebuilt
from tests.nets.reconstruct.fibres.three_lines import LINES, SCENE, N, error_um, noisy_image
from warp_caustics.prints.model import LineModel
from warp_caustics.reconstruct.result import Resimulation
from warp_caustics.simulator import CausticSimulator


@pytest.fixture(scope="module")
def model():
    return LineModel(SCENE)


@pytest.fixture(scope="module")
def image(model):
    return noisy_image(model)


@pytest.fixture(scope="module")
def fit(model, image):
    return ImageFit(SCENE, image, model, 2 * N)


@pytest.fixture(scope="module")
def answer(model):
    """Of a network that is 20 um wrong and says so."""
    noise = torch.randn(N, N, generator=torch.Generator().manual_seed(3))
    return model.heights(LINES) + 2e-5 * noise, torch.full((N, N), 2e-5)


def view_of(model, image):
    return LinesView(Resimulation(CausticSimulator(SCENE, "lattice"), image, np.ones(3)), model)


def too_short():
    """An end that is 9 mm too soon, six samples here; 2.3 mm are six of a plate of Tab. 1."""
    lines = LINES.clone()
    lines[1] = stretched(lines[1], 2, -9e-3)
    return lines


def in_pieces():
    """Half of a wide line taken for three narrow ones, and another for longer than it is."""
    start, end, middle = LINES[0, :2], LINES[0, 2:4], LINES[0, :4].reshape(2, 2).mean(0)
    way = (end - start) / (end - start).norm()
    beside = torch.stack([-way[1], way[0]])
    kept = LINES.clone()
    kept[0, :2] = middle
    pieces = [
        torch.cat([start + a * way + off * beside, start + b * way + off * beside, torch.tensor([2e-3, 5e-4])])
        for a, b, off in ((0.0, 8e-3, 1e-3), (1e-3, 9e-3, -1e-3), (8e-3, 15e-3, 0.0))
    ]
    return torch.cat([kept, torch.stack(pieces)])


@pytest.mark.parametrize("start", [too_short(), LINES[[0, 2]]], ids=["too short", "missed"])
def test_what_descents_stay_with_is_mended(model, fit, answer, start):
    """An end that is too soon, and a line that was missed."""
    was, stayed = error_um(model, start), fit.descend(start, 20)
    assert error_um(model, stayed.lines) > 0.5 * was
    found = rebuilt(fit, start, *answer, is_enough=lambda lines: error_um(model, lines) < 0.1 * was)
    assert error_um(model, found.lines) < 0.3 * was and found.loss < 0.5 * stayed.loss


def test_lines_give_way_to_the_one_they_stand_for(model, fit, answer):
    start = in_pieces()
    found = rebuilt(fit, start, *answer, is_enough=lambda lines: len(lines) < len(start))
    assert len(found.lines) < len(start) and error_um(model, found.lines) < 0.3 * error_um(model, start)


def test_it_ends_where_lines_are_good_enough(fit, answer):
    asked = []
    rebuilt(fit, LINES[[0]], *answer, is_enough=lambda lines: asked.append(lines) is None)
    assert len(asked) == 1


@pytest.mark.parametrize("is_right", [True, False])
def test_a_search_builds_anew_only_what_is_wrong_in_places(model, image, answer, monkeypatch, is_right):
    """Lines that leave noise everywhere stay as they are, bit for bit."""
    view = view_of(model, image)
    search = LineSearch(SCENE, image, model, 2 * N, jumps=1, answer=Answer(*answer), view=view)
    start = LINES if is_right else too_short()
    monkeypatch.setattr(search, "_find", lambda lines: setattr(search, "lines", lines))
    monkeypatch.setattr(view, "is_near", lambda lines: True)
    assert view.is_wrong_in_places(start) != is_right
    found = search.run(start)
    if is_right:
        assert found is start
    else:
        assert error_um(model, found) < 0.1 * error_um(model, start) and not view.is_wrong_in_places(found)


def test_a_search_keeps_lines_that_explain_all_pixels_better(model, image, answer, monkeypatch):
    view, start = view_of(model, image), too_short()
    search = LineSearch(SCENE, image, model, 2 * N, jumps=1, answer=Answer(*answer), view=view)
    monkeypatch.setattr(search, "_find", lambda lines: setattr(search, "lines", lines))
    monkeypatch.setattr(view, "is_near", lambda lines: True)
    monkeypatch.setattr(view, "left", lambda lines: 1.0 if lines is start else 1.1)
    assert search.run(start) is start

    def stopped(self):
        raise KeyboardInterrupt

    monkeypatch.setattr(LineSearch, "_finish", stopped)
    with pytest.raises(KeyboardInterrupt):
        search.run(start)
    assert search.lines is start


def test_a_few_lines_descend_over_the_others(model, fit):
    start = LINES.clone()
    start[1, :4] += 2e-4
    found = descended(fit, start, [1], 10)
    assert torch.equal(found.lines[:2], start[[0, 2]])
    assert error_um(model, found.lines) < 0.2 * error_um(model, start)
    assert found.loss == pytest.approx(fit.loss(model.heights(found.lines)), rel=1e-4)
    kept = model.shape
    try:
        # Where lines cross the highest is printed: the others count there, too.
        model.shape = kept._replace(overlap=0.5)
        found = descended(fit, start, [1], 3)
        assert found.loss == pytest.approx(fit.loss(model.heights(found.lines)), rel=1e-4)
    finally:
        model.shape = kept
    assert descended(fit, start, [], 3).loss == pytest.approx(fit.loss(model.heights(start)), rel=1e-4)


def test_a_place_is_cleared():
    """What lies within goes; what ends there is cut to its edge, one by one and all."""
    lines = 1e-3 * torch.tensor(
        [
            [0.0, 0.0, 1.0, 1.0, 1.0, 0.5],
            [-9.0, 0.0, 1.0, 0.0, 1.0, 0.5],
            [0.0, 1.0, 0.0, 9.0, 1.0, 0.5],
            [-9.0, -9.0, 9.0, -9.0, 1.0, 0.5],
        ],
        dtype=torch.float64,
    )
    found = list(clearings(lines, (0.0, 0.0), 3e-3))
    assert [(len(each.lines), each.cut, each.taken) for each in found] == [
        (3, [], 1),
        (3, [0], 1),
        (3, [1], 1),
        (3, [0, 1], 1),
    ]
    torch.testing.assert_close(found[-1].lines[0, 2:4], torch.tensor([-3e-3, 0.0], dtype=torch.float64))
    torch.testing.assert_close(found[-1].lines[1, :2], torch.tensor([0.0, 3e-3], dtype=torch.float64))
    assert not list(clearings(lines[3:], (0.0, 0.0), 3e-3))
    beyond = cut_back(lines[1], 2, (-8.9e-3, 0.0), 3e-3)
    assert float((beyond[2:4] - beyond[:2]).norm()) == pytest.approx(1e-4, rel=1e-3)


def test_what_lies_at_a_place(model):
    area = float(within(model, (1e-3, -2e-3), 5e-3).sum()) * math.prod(SCENE.sample_pitch_m)
    assert area == pytest.approx(math.pi * 25e-6, rel=0.15)
    assert reaching(model, LINES, (0.0, 9.5e-3), 2e-3) == [2]
