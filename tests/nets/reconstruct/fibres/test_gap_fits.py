"""What a run becomes by another gap, base or index, and when that is kept."""

from types import SimpleNamespace

import pytest

from nets.reconstruct.fibres import lines_of_image
from nets.reconstruct.fibres.bench import gap_fits
from nets.reconstruct.fibres.bench.gap_fits import (
    fit_as_noise_tells,
    fit_with_every_number,
    fit_with_gap,
    least_gain,
    unlikely,
)
from nets.reconstruct.fibres.bench.gap_of_lines import likeliest
from nets.reconstruct.fibres.bench.line_posterior import misfit_weight
from nets.reconstruct.fibres.bench.run_state import RunState
from nets.reconstruct.fibres.image.lines_view import LinesView
from tests.nets.reconstruct.fibres.test_bench_fits import NUMBERS, bench_with, photographed, run_with
from tests.nets.reconstruct.fibres.three_lines import LINES, SCENE
from warp_caustics.prints.model import LineModel

WIDER_M = 4e-5


@pytest.fixture(scope="module")
def model():
    return LineModel(SCENE)


@pytest.mark.parametrize(("leaves", "is_kept"), [(2.68, True), (2.699, False), (2.71, False)])
def test_a_gap_is_kept_though_a_lens_is_missing(model, monkeypatch, leaves, is_kept):
    """Where lines leave less by as much as the valley has told, not by a tenth."""
    run = run_with(model, photographed(model, bench_with(gap_m=WIDER_M)), LINES)
    bench, found = run.bench, bench_with(gap_m=WIDER_M)
    monkeypatch.setattr(gap_fits, "is_other_glass", lambda run: False)
    monkeypatch.setattr(gap_fits, "gap_of_lines", lambda run, asked: (run.together(), (run.lines, found)))
    monkeypatch.setattr(gap_fits, "least_gain", lambda run, squares: 0.998)
    monkeypatch.setattr(LinesView, "left", lambda view, _: leaves if is_wider(view.scene) else 2.7)
    monkeypatch.setattr(LinesView, "is_explained", lambda view, _: False)
    fit_with_gap(run)
    assert run.bench.values["gap_m"] == (WIDER_M if is_kept else bench.values["gap_m"])


def is_wider(scene):
    return -scene.screen_position_m[2] > 0.9 * WIDER_M


def test_a_lens_that_was_found_is_asked_on_the_other_bench(model, monkeypatch):
    run = run_with(model, photographed(model, bench_with(gap_m=WIDER_M)), LINES)
    asked = []
    monkeypatch.setattr(gap_fits, "is_other_glass", lambda run: False)
    monkeypatch.setattr(gap_fits, "fit_with_spread", lambda run: asked.append(run.bench.values["gap_m"]))
    found = bench_with(gap_m=WIDER_M)
    monkeypatch.setattr(gap_fits, "gap_of_lines", lambda run, _: (run.together(), (run.lines, found)))
    fit_with_gap(run)
    assert asked == [], "there is none"
    monkeypatch.setattr(gap_fits, "_fit_with_lens", lambda run: asked.append(run.bench.values["gap_m"]))
    run = run_with(model, photographed(model, bench_with(gap_m=WIDER_M)), LINES)
    fit_with_gap(run)
    assert asked == [WIDER_M]


def test_what_is_left_falls_by_what_is_told(model):
    run = run_with(model, photographed(model, bench_with()), LINES)
    counted = float((run.view.discrepancy.whole.weight > 0).sum())
    assert least_gain(run, 0.0) == 1.0
    assert 1 - least_gain(run, 16.0) == pytest.approx(800 / counted)
    assert least_gain(run, -16.0) > 1.0


@pytest.mark.parametrize(("leaves", "is_kept"), [((0.999, 0.998), True), ((1.0, 1.001), False)])
def test_a_bench_is_asked_by_what_noise_lets_an_image_tell(model, monkeypatch, leaves, is_kept):
    run, asked = run_with(model, photographed(model, bench_with(gap_m=WIDER_M)), LINES), []
    left = dict(enumerate((1.0, *leaves), start=1))
    run.bench, run.asked = bench_with(gap_m=WIDER_M), ("gap_m",)
    run.view = run.on(run.bench)

    def with_valley(together, lines, bench):
        asked.append(together.correlated_px)
        return lines, bench_with(gap_m=(1 + len(asked)) * WIDER_M)

    monkeypatch.setattr(gap_fits, "with_valley", with_valley)
    monkeypatch.setattr(LinesView, "left", lambda view, _: left[round(-view.scene.screen_position_m[2] / WIDER_M)])
    monkeypatch.setattr(LinesView, "is_settled", lambda view, _: True)
    fit_as_noise_tells(run)
    assert asked == [10.0, 1.0]
    assert run.bench.values["gap_m"] == pytest.approx((3 if is_kept else 1) * WIDER_M)
    assert (run.covariance is not None) == is_kept
    run.asked = ("ambient",)
    fit_as_noise_tells(run)
    run.asked = ("gap_m",)
    monkeypatch.setattr(LinesView, "is_settled", lambda view, _: False)
    fit_as_noise_tells(run)
    assert len(asked) == 2, "gap, base and index are as told, or more than noise is left"


@pytest.mark.parametrize(
    ("told_share", "is_asked"), [((1e-3, 1e-2), False), ((-3e-3, 2e-3), False), ((6e-3, 2e-3), True), (None, True)]
)
def test_a_bench_as_told_is_asked_only_where_lines_nearly_tell_another(model, monkeypatch, told_share, is_asked):
    run, asked = run_with(model, photographed(model, bench_with()), LINES), []
    run.asked, run.told_share = ("gap_m",), told_share

    def with_valley(together, lines, bench):
        asked.append(together.correlated_px)
        return lines, bench

    monkeypatch.setattr(gap_fits, "with_valley", with_valley)
    monkeypatch.setattr(LinesView, "is_settled", lambda view, _: True)
    fit_as_noise_tells(run)
    assert bool(asked) == is_asked


def test_fewer_pixels_that_err_together_weigh_a_belief_less(model):
    run = run_with(model, photographed(model, bench_with()), LINES)
    together = run.together()
    fit = together.fit_on(run.bench)
    weight = together._beside(fit, LINES, run.bench, 0.01).weight
    together.correlated_px /= 10
    assert together._beside(fit, LINES, run.bench, 0.01).weight == pytest.approx(weight / 10)
    assert weight == pytest.approx(misfit_weight(fit, 0.01)) == pytest.approx(10 * misfit_weight(fit, 0.01, 10.0))


def test_how_unlikely_a_bench_is():
    """About the squares of deviations nearby, far less far away; of numbers that are bent light's alone."""
    widths = {p.name: p.prior for p in NUMBERS.parameters}
    assert unlikely(NUMBERS, bench_with()) == unlikely(NUMBERS, bench_with(screen_x_m=1e-3)) == 0.0
    near = bench_with(gap_m=0.5 * widths["gap_m"], index_offset=-0.5 * widths["index_offset"])
    assert unlikely(NUMBERS, near) == pytest.approx(0.5, rel=0.25)
    far = unlikely(NUMBERS, bench_with(gap_m=30 * widths["gap_m"]))
    assert 20 < far < 40
    assert far - unlikely(NUMBERS, bench_with(gap_m=20 * widths["gap_m"])) < 5


@pytest.mark.parametrize(("likely_leaves", "is_kept"), [(1.00002, True), (1.05, False)])
def test_a_likelier_bench_may_leave_a_little_more(model, monkeypatch, likely_leaves, is_kept):
    run = run_with(model, photographed(model, bench_with()), LINES)
    # A base and a glass that make up for one another.
    run.bench = bench_with(base_thickness_m=3e-3 + 1.5e-4, index_offset=-5e-3)
    before = run.bench
    monkeypatch.setattr(gap_fits, "with_valley", lambda together, lines, bench: (lines, bench))
    monkeypatch.setattr(gap_fits, "told_by", lambda run, together: None)
    monkeypatch.setattr(gap_fits, "FAR", 0.0)
    monkeypatch.setattr(
        LinesView, "left", lambda view, _: 1.0 if view.scene.base_thickness_m > 3.1e-3 else likely_leaves
    )
    fit_with_every_number(run)
    assert (run.bench is not before) == is_kept
    assert (run.bench.values == likeliest(NUMBERS, before).values) == is_kept


@pytest.mark.parametrize("finds_gap", [True, False])
def test_a_missing_lens_is_asked_before_all_numbers(monkeypatch, finds_gap):
    """Where gap or light were found."""
    run, asked = SimpleNamespace(bench=0, view=0, method=SimpleNamespace(takes_bench_as_told=False, options=None)), []
    run._is_near = run._asks_bench = lambda: True
    monkeypatch.setattr(lines_of_image, "fit_with_light", lambda run: asked.append("light"))
    monkeypatch.setattr(lines_of_image, "fit_with_bench", lambda run: asked.append("bench"))
    monkeypatch.setattr(lines_of_image, "fit_through_blurring_lens", lambda run: asked.append("lens"))

    def fit_with_gap(run):
        asked.append("gap")
        run.bench += finds_gap

    monkeypatch.setattr(lines_of_image, "fit_with_gap", fit_with_gap)
    lines_of_image.LinesOfImage._fit_with_bench(run)
    assert asked == ["light", "gap", *["lens"] * finds_gap, "bench"]


def test_what_was_left_is_that_of_its_own_section(model):
    """Of a state before the section moved."""
    run = run_with(model, photographed(model, bench_with()), LINES)
    state, was, own = RunState.of(run), run.view.left(run.lines), model.shape
    try:
        model.shape = own._replace(exponent=1.3)
        assert run.view.left(run.lines) > 1.5 * was
        assert state.left == was
        assert model.shape != own, "which stays"
    finally:
        model.shape = own
