"""A network looks at lines that leave part of an image unexplained, and lines are searched for anew."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

import nets.reconstruct.fibres.lines_of_image as lines_module
import nets.reconstruct.fibres.search.line_search as line_search
import nets.reconstruct.fibres.search.second_look as second_look
import nets.reconstruct.network_answers as answers_module
from nets.reconstruct.direct import Direct
from nets.reconstruct.fibres.bench.bench_of_lines import BenchOfLines
from nets.reconstruct.fibres.bench.line_posterior import JointCovariance
from nets.reconstruct.fibres.image.descent import Fitted
from nets.reconstruct.fibres.lines_of_image import LinesOfImage
from nets.reconstruct.fibres.options import FibresOptions
from nets.reconstruct.methods import create
from tests.nets.reconstruct.fibres.three_lines import LINES, SCENE, N, noisy_image
from warp_caustics.errors import MismatchError
from warp_caustics.prints.model import LineModel
from warp_caustics.reconstruct.result import Resimulated


@pytest.fixture(scope="module")
def model():
    return LineModel(SCENE)


@pytest.fixture(scope="module")
def image(model):
    return noisy_image(model)


def relief(model, lines, noise_m, seed=1):
    heights = model.heights(lines).double().numpy()
    return heights + noise_m * np.random.default_rng(seed).standard_normal(heights.shape)


@pytest.fixture
def method(monkeypatch, saved, model):
    """``fibres`` whose network misses a line at first and takes the others for higher; looking again it says what it is
    told."""

    def make(said, by_heights=False, **options):
        if not by_heights:
            monkeypatch.setattr(second_look, "_by_heights", lambda run, found: False)
        first = torch.as_tensor(1.6 * relief(model, LINES[:2], 1e-5), dtype=torch.float32)
        monkeypatch.setattr(
            answers_module, "Replayed", lambda _: lambda images: first.expand(len(images), N, N).clone()
        )
        shown = []

        def looked_again(self, resimulation, heights):
            shown.append(heights)
            return None if said is None else (torch.as_tensor(said), torch.full((N, N), 1e-6))

        monkeypatch.setattr(Direct, "looked_again", looked_again)
        weights = saved("direct", scene=SCENE)
        options = {"refine": False, "set_up": "known", "jumps": 0, "refine_pixels": 2 * N, "looks": 2} | options
        return create("fibres", SCENE, weights=weights, symmetries=False, **options), shown

    return make


def error_um(result, model):
    return 1e6 * float(np.sqrt(np.mean((result.heights_m - model.heights(LINES).double().numpy()) ** 2)))


def test_a_line_that_was_missed_is_found_at_the_second_look(model, image, method):
    """The network is shown the lines that were found, of which one is missing; once is enough."""
    fibres, shown = method(relief(model, LINES, 1e-5))
    result = fibres.reconstruct(image)
    assert len(shown) == 1 and result.counters["looks"] == 1
    assert result.counters["fibres"] == 3 and error_um(result, model) < 1.0
    left_out = model.heights(LINES).numpy() - model.heights(LINES[:2]).numpy()
    assert np.abs(shown[0][left_out > 1e-4]).mean() < np.abs(model.heights(LINES).numpy()[left_out > 1e-4]).mean() / 2


def test_a_line_that_was_missed_is_grown_where_heights_go(model, image, method, monkeypatch):
    """A descent of heights begins to grow it; no network need be asked. It is what is left of the image else."""

    def nothing_seen(fit, lines, most, quick):
        return Fitted(lines, fit.loss(fit.model.heights(lines)))

    assert "looks" not in method(None, by_heights=True, jumps=1)[0].reconstruct(image).counters
    monkeypatch.setattr(line_search, "grown_in_shadows", nothing_seen)
    fibres, shown = method(None, by_heights=True, jumps=1)
    result = fibres.reconstruct(image)
    assert not shown and result.counters["looks"] == 1
    assert result.counters["fibres"] == 3 and error_um(result, model) < 1.0


@pytest.mark.parametrize("said", ["worse", "nothing"])
def test_what_explains_less_is_not_taken(model, image, method, said):
    """A network that says worse, or cannot look again, changes nothing; nobody asks where nobody wants to."""
    fibres, shown = method(relief(model, LINES[:1], 1e-5) if said == "worse" else None)
    result = fibres.reconstruct(image)
    assert len(shown) == 1 and "looks" not in result.counters
    plain, not_shown = method(None, looks=0)
    expected = plain.reconstruct(image)
    np.testing.assert_allclose(result.heights_m, expected.heights_m, atol=1e-12)
    assert not not_shown and result.counters["section"] == expected.counters["section"]


def test_lines_that_explain_the_image_are_not_looked_at(model, image, method, monkeypatch):
    fibres, shown = method(None)
    whole = torch.as_tensor(relief(model, LINES, 1e-5), dtype=torch.float32)
    monkeypatch.setattr(answers_module, "Replayed", lambda _: lambda images: whole.expand(len(images), N, N).clone())
    fibres.network.asked[0].replayed = answers_module.Replayed(None)
    assert fibres.reconstruct(image).counters["fibres"] == 3 and not shown


def test_an_interrupted_look_keeps_the_lines_of_before(model, image, method, monkeypatch):
    def stopped(self, resimulation, heights):
        raise KeyboardInterrupt

    fibres, _ = method(None)
    monkeypatch.setattr(Direct, "looked_again", stopped)
    result = fibres.reconstruct(image)
    plain, _ = method(None, looks=0)
    assert result.stop_reason == "interrupted"
    np.testing.assert_allclose(result.heights_m, plain.reconstruct(image).heights_m, atol=1e-12)


def test_looks_by_device():
    assert [FibresOptions().looks_on(device) for device in ("cpu", "cuda")] == [0, 2]
    assert FibresOptions(looks=3).looks_on("cpu") == 3


def test_the_last_network_with_feedback_is_shown_the_lines_and_their_caustic():
    """Mean and spread of its answers."""
    heights, caustic, image = np.full((4, 4), 1e-3), torch.ones(1, 8, 8), SimpleNamespace()

    class Looks:
        has_feedback = True

        def look(self, relief_m, seen):
            assert torch.equal(relief_m, torch.as_tensor(heights)) and seen is caustic
            return "look"

        def __call__(self, given, look):
            assert given is image and look == "look"
            yield torch.full((2, 4, 4), 1.0)
            yield torch.full((2, 4, 4), 3.0)

    class Resimulation:
        def __init__(self):
            self.image = image

        def __call__(self, relief_m):
            return Resimulated(caustic, 0.5)

    without = SimpleNamespace(has_feedback=False)
    mean, spread = Direct.looked_again(SimpleNamespace(asked=[without, Looks()]), Resimulation(), heights)
    assert torch.equal(mean, torch.full((4, 4), 2.0)) and torch.equal(spread, torch.ones(4, 4))
    assert Direct.looked_again(SimpleNamespace(asked=[without]), Resimulation(), heights) is None


def test_what_is_known_of_a_bench_is_of_the_lines_in_the_end(model, image, method, monkeypatch):
    """Lines that were found after bench and lines together have a covariance of their own."""
    runs = []

    def with_all(self):
        runs.append(self)
        self.covariance, self.counted = JointCovariance(np.eye(self.lines.numel())), self.lines

    monkeypatch.setattr(LinesOfImage, "_fit_with_all", with_all)
    monkeypatch.setattr(LinesOfImage, "_is_near", lambda self: False)
    monkeypatch.setattr(
        BenchOfLines, "covariance", lambda self, lines, bench: JointCovariance(2 * np.eye(lines.numel()))
    )
    fibres, _ = method(relief(model, LINES, 1e-5))
    fibres.reconstruct(image)
    (run,) = runs
    assert len(run.lines) == 3 and run.counted is run.lines
    np.testing.assert_array_equal(run.covariance.matrix, 2 * np.eye(18))


def test_an_interrupted_look_leaves_no_covariance_of_other_lines(model, image, method, monkeypatch):
    def look(run, looks):
        run.lines = run.lines[:1]
        raise KeyboardInterrupt

    def with_all(self):
        runs.append(self)
        self.covariance, self.counted = JointCovariance(np.eye(self.lines.numel())), self.lines

    runs = []
    monkeypatch.setattr(LinesOfImage, "_fit_with_all", with_all)
    monkeypatch.setattr(lines_module, "look_again", look)
    fibres, _ = method(None)
    fibres.reconstruct(image)
    assert runs[0].covariance is None and runs[0].reason == "interrupted"


def test_a_bench_beyond_the_family_is_not_looked_at(model, image, method, monkeypatch):
    """The network is asked on the bench that was found, where it knows it."""
    asked = []

    def on_bench(self, scene):
        asked.append(scene)
        raise MismatchError("beyond")

    monkeypatch.setattr(Direct, "on_bench", on_bench)
    fibres, _ = method(relief(model, LINES, 1e-5))
    run = SimpleNamespace(method=fibres, view=SimpleNamespace(scene=SCENE), told=None)
    assert second_look.network_here(run) is None and asked == [SCENE]
    assert second_look.network_here(SimpleNamespace(method=fibres, view=1, told=1)) is fibres.network


def searched(left, after, others):
    """A run whose lines leave so much, and whose searches leave what is said, one after the other."""
    model = SimpleNamespace(shape="shape")
    view = SimpleNamespace(is_explained=lambda lines: False, resimulation=None)
    options = SimpleNamespace(jumps=1)
    network = SimpleNamespace(looked_again=lambda resimulation, heights: (torch.zeros(N, N), torch.zeros(N, N)))
    method = SimpleNamespace(options=options, network=network)
    run = SimpleNamespace(model=model, view=view, told=view, method=method, moves_section=False, most_lines=9)
    run.lines, of = torch.full((1, 6), -1.0), {-1.0: left}
    run.left = lambda: (None, of[float(run.lines[0, 0])], 1.0)

    def search(start, jumps, answer, other=None):
        assert jumps == 1  # what the method has, though a look would take more
        others.append((float(start[0, 0]), None if other is None else float(other[0, 0])))
        number = float(len(others))
        run.lines, of[number] = torch.full((1, 6), number), after[len(others) - 1]

    run.search = search
    return run


@pytest.mark.parametrize(
    ("after", "tried", "kept"),
    [
        ([0.5, 0.4], [(0.0, None), (1.0, -1.0)], 2.0),
        ([0.9, 0.4], [(0.0, None), (-1.0, 1.0)], 2.0),
        ([0.5, 0.5], [(0.0, None), (1.0, -1.0)], 1.0),
        ([0.9, 0.8], [(0.0, None), (-1.0, 1.0)], -1.0),
    ],
)
def test_the_better_lines_are_searched_on_with_the_others_at_hand(monkeypatch, after, tried, kept):
    """Those of before are -1 and leave 0.7, those found anew are 1, those of both 2."""
    monkeypatch.setattr(second_look, "lines_of_relief", lambda model, relief_m, spread_m, most: torch.zeros(1, 6))
    others = []
    run = searched(0.7, after, others)
    assert second_look._by_network(run) == (kept > 0)
    assert others == tried and float(run.lines[0, 0]) == kept and not run.is_in_vain
