"""Lines that leave more than noise are searched for from single answers of the network."""

from types import SimpleNamespace

import pytest
import torch

import nets.reconstruct.fibres.search.other_starts as other_starts
import nets.reconstruct.fibres.search.second_look as second_look
import nets.reconstruct.network_answers as answers_module
from nets.reconstruct.direct import Direct
from nets.reconstruct.fibres.options import FibresOptions
from nets.reconstruct.fibres.search.line_search import LineSearch
from nets.reconstruct.methods import create
from tests.nets.reconstruct.fibres.three_lines import LINES, SCENE, N, noisy_image
from warp_caustics.prints.model import LineModel


@pytest.fixture(scope="module")
def model():
    return LineModel(SCENE)


@pytest.fixture(scope="module")
def image(model):
    return noisy_image(model)


@pytest.fixture
def method(monkeypatch, saved, model):
    """``fibres`` whose network misses a line; of its single answers one has it, and misses another."""

    def make(singles, **options):
        monkeypatch.setattr(other_starts, "FEWEST_LINES", 1)
        monkeypatch.setattr(second_look, "look_again", lambda run, looks: False)
        first = (1.3 * model.heights(LINES[:2])).float()
        monkeypatch.setattr(
            answers_module, "Replayed", lambda _: lambda images: first.expand(len(images), N, N).clone()
        )
        asked = []

        def first_answers(self, given):
            asked.append(given)
            return singles

        monkeypatch.setattr(Direct, "first_answers", first_answers)
        settings = {"refine": False, "set_up": "known", "jumps": 0, "refine_pixels": 2 * N, "looks": 0} | options
        return create("fibres", SCENE, weights=saved("direct", scene=SCENE), symmetries=False, **settings), asked

    return make


def singles_of(model):
    return torch.stack([model.heights(LINES[:2]), model.heights(LINES[1:]), model.heights(LINES[:2])]).float()


def error_um(result, model):
    return 1e6 * float((torch.as_tensor(result.heights_m) - model.heights(LINES)).square().mean().sqrt())


def test_the_better_lines_of_another_start_are_taken(model, image, method):
    """The mean of the answers misses the third line; an answer that has it misses the first."""
    fibres, asked = method(singles_of(model), starts=3)
    result = fibres.reconstruct(image)
    plain, not_asked = method(singles_of(model), starts=0)
    before = plain.reconstruct(image)
    assert len(asked) == 1 and not not_asked
    assert before.counters["fibres"] == 2 and "starts" not in before.counters
    assert result.counters["fibres"] == 3 and 1 <= result.counters["starts"] <= 3
    assert error_um(result, model) < 1.0 < error_um(before, model)


def test_answers_that_say_the_same_change_nothing(model, image, method):
    """And one answer alone is no other start."""
    plain, _ = method(singles_of(model), starts=0)
    before = plain.reconstruct(image)
    for singles in (model.heights(LINES[:2]).float().expand(4, N, N), model.heights(LINES).float()[None]):
        fibres, _ = method(singles, starts=2)
        result = fibres.reconstruct(image)
        assert result.counters["fibres"] == 2
        assert error_um(result, model) == pytest.approx(error_um(before, model), rel=0.05)


def test_few_lines_and_lines_that_explain_the_image_are_left(model, image, method, monkeypatch):
    fibres, asked = method(singles_of(model), starts=3)
    monkeypatch.setattr(other_starts, "FEWEST_LINES", 3)
    fibres.reconstruct(image)
    assert not asked


@pytest.mark.parametrize(("meets", "left", "asked"), [(False, 2.0, 1), (False, 2.8, 0), (True, 2.0, 0), (True, 0.7, 1)])
def test_straight_lines_may_leave_more_to_be_searched_for(monkeypatch, meets, left, asked):
    """Than pieces of curves, which leave much because they are none."""
    tried = []
    view = SimpleNamespace(is_settled=lambda lines: False)
    run = SimpleNamespace(lines=torch.zeros(9, 6), reason="converged", is_crowd=False, view=view, counters={})
    run.may_be_pieces, run.left = lambda: meets, lambda: (None, left, 1.0)
    monkeypatch.setattr(other_starts, "_answers", lambda run, starts: iter("a"))
    monkeypatch.setattr(other_starts, "searched_in", lambda *args: tried.append(args))
    other_starts.start_elsewhere(run, 3)
    assert len(tried) == asked


def test_lines_that_were_left_are_searched_for_elsewhere(model, image, method, monkeypatch):
    """Those that leave more of the image than the relief they were found in, which the search gave up."""
    fibres, asked = method(singles_of(model), starts=3)
    search = LineSearch.run

    def in_vain(self, start):
        found = search(self, start)
        self.is_in_vain = not asked
        return found

    monkeypatch.setattr(LineSearch, "run", in_vain)
    result = fibres.reconstruct(image)
    assert asked and result.counters["fibres"] == 3 and error_um(result, model) < 1.0


def test_starts_by_device():
    assert [FibresOptions().starts_on(device) for device in ("cpu", "cuda")] == [0, 3]
    assert FibresOptions(starts=5).starts_on("cpu") == 5
