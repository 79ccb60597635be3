"""A section that is nearly the usual one, asked of lines that explain the image nearly."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

import nets.reconstruct.fibres.bench.section_of_lines as section_of_lines
from nets.reconstruct.fibres.bench.run_state import RunState
from nets.reconstruct.fibres.bench.section_of_lines import fit_with_section, fit_with_section_or_bench
from nets.reconstruct.fibres.image.lines_view import LinesView
from tests.nets.reconstruct.exact_light import light_of
from tests.nets.reconstruct.fibres.line_run import line_run
from tests.nets.reconstruct.fibres.three_lines import LINES, SCENE
from warp_caustics.prints.line_shape import Shape
from warp_caustics.prints.model import LineModel
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.result import Resimulation
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.simulator import CausticSimulator

NOISE = 0.01


def run_of(printed, **about):
    """Lines of the usual section nearly where they were printed."""
    truth = LineModel(SCENE)
    truth.shape = printed
    heights = truth.heights(LINES)
    shown = light_of(SCENE, heights).numpy()
    white = NOISE * np.random.default_rng(0).standard_normal(shown.shape)
    image = CausticImage((shown + white).astype(np.float32), np.full(len(shown), NOISE))
    model = LineModel(SCENE)
    plain = Resimulation(CausticSimulator(SCENE, "lattice"), image, np.ones(len(shown)))
    view = LinesView(plain.through(ChannelCamera.perfect(len(shown), SCENE.image_pixels)), model)
    method = SimpleNamespace(finds_section=True)
    run = SimpleNamespace(method=method, model=model, view=view, lines=LINES + 1e-6, moves_section=False)
    run.note = lambda loss: None
    vars(run).update(about)

    def search(start, jumps):
        assert jumps == 0 and run.moves_section
        run.lines = start

    run.search = about.get("search", search)
    return run, heights


def error_um(run, heights):
    return 1e6 * float((run.model.heights(run.lines) - heights).square().mean().sqrt())


@pytest.mark.parametrize("power", [0.85, 1.2])
def test_a_section_that_is_nearly_the_usual_one_is_found(power):
    run, heights = run_of(Shape(power))
    before = error_um(run, heights)
    fit_with_section(run)
    assert run.moves_section and run.model.shape.exponent == pytest.approx(power, abs=0.03)
    assert error_um(run, heights) < 0.5 * before


def test_the_usual_section_stays():
    run, _ = run_of(Shape())
    lines = run.lines
    fit_with_section(run)
    assert run.lines is lines and run.model.shape == Shape() and not run.moves_section


def test_a_section_that_is_told_or_moves_is_not_asked():
    for about in ({"moves_section": True}, {"method": SimpleNamespace(finds_section=False)}, {"lines": LINES[:0]}):
        run, _ = run_of(Shape(0.85), **about)
        lines = run.lines
        fit_with_section(run)
        assert run.lines is lines and run.model.shape == Shape()


def test_lines_that_end_worse_are_as_they_were():
    def worse(start, jumps):
        run.lines = start + torch.tensor([0, 0, 0, 0, 0, 2e-4], dtype=torch.float64)

    run, _ = run_of(Shape(0.85), search=worse)
    lines = run.lines
    fit_with_section(run)
    assert run.lines is lines and run.model.shape == Shape() and not run.moves_section


def test_a_run_that_is_out_of_time_keeps_its_lines():
    def late(loss):
        raise KeyboardInterrupt

    run, _ = run_of(Shape(0.85), note=late)
    lines = run.lines
    with pytest.raises(KeyboardInterrupt):
        fit_with_section(run)
    assert run.lines is lines and run.model.shape == Shape() and not run.moves_section


@pytest.fixture
def asked(monkeypatch):
    """A section that leaves 1.0 of the image, and what a bench leaves; lines of either are told by their first number."""

    def section(run):
        run.moves_section, run.lines = True, run.lines + 1

    def ask(left_by_bench):
        monkeypatch.setattr(section_of_lines, "fit_with_section", section)
        view = SimpleNamespace(left=lambda lines: {1.0: 1.0, 2.0: left_by_bench}.get(float(lines[0]), 0.9))
        run = line_run(view=view)

        def bench():
            if left_by_bench is not None:
                run.lines, run.bench = run.lines + 2, run.bench + 1

        fit_with_section_or_bench(run, bench)
        return run

    return ask


@pytest.mark.parametrize(
    ("left_by_bench", "sum_of_numbers"),
    [(0.95, 3.0), (1.0004, 3.0), (1.01, 3.0), (None, 1.0)],
    ids=["bench", "as well", "section", "no bench"],
)
def test_both_are_asked_in_the_end(asked, left_by_bench, sum_of_numbers):
    run = asked(left_by_bench)
    assert run.moves_section and float(run.lines[0]) == sum_of_numbers


@pytest.mark.parametrize(("left_by_bench", "first"), [(0.95, "bench"), (1.01, "section")])
def test_what_leaves_less_has_the_first_word(asked, monkeypatch, left_by_bench, first):
    order = []
    put = RunState.put

    def noted(found, run):
        order.append("section" if found.moves_section else "before")
        put(found, run)

    monkeypatch.setattr(RunState, "put", noted)
    asked(left_by_bench)
    assert order == (["before"] if first == "bench" else ["before", "section"])
