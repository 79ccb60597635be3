"""Benches far from what was told: beliefs that are widened, and which of three numbers it was."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from nets.reconstruct.fibres.bench import less_believed as less_believed_module
from nets.reconstruct.fibres.bench.bench_and_light import Bench, seen_on
from nets.reconstruct.fibres.bench.bench_of_lines import BenchOfLines
from nets.reconstruct.fibres.bench.gap_of_lines import GapOfLines, on_other_bench
from nets.reconstruct.fibres.bench.less_believed import (
    FAR,
    LEAST_HINT,
    gap_of_lines,
    is_other_glass,
    less_believed,
    number_of_glass,
    widened,
)
from nets.reconstruct.fibres.image.image_fit import ImageFit
from nets.reconstruct.fibres.image.lines_view import LinesView
from nets.reconstruct.fibres.trust.beliefs import NO_BENCH, UNCLEAR_SHARE, left_open_by_hint, left_open_by_unclear_bench
from tests.nets.reconstruct.fibres.test_gap_of_lines import (
    LINES,
    SCENE,
    SHARP,
    N,
    error_um,
    numbers,
    on_told_bench,
    photographed,
)
from warp_caustics.errors import InputError
from warp_caustics.found_bench.bench_uncertainty import GLASS
from warp_caustics.found_bench.thin_relief import ThinRelief
from warp_caustics.prints.model import LineModel
from warp_caustics.reconstruct.result import Resimulation
from warp_caustics.setup.optical import with_optical_values
from warp_caustics.simulator import CausticSimulator


class Run:
    """What the search needs of a run."""

    def __init__(self, model, image, told):
        self.model, self.image, self.numbers = model, image, told
        self.hinted = 0.0
        self.lines, self.bench = on_told_bench(model, image), Bench.told(told)

    def on(self, bench):
        simulator = CausticSimulator(self.numbers.scene_of(bench.values), "lattice")
        image = seen_on(self.image, self.numbers, bench)
        return LinesView(Resimulation(simulator, image, np.ones(3)), self.model)

    def together(self, names=None):
        numbers = self.numbers if names is None else self.numbers.only(names)
        return BenchOfLines(numbers, self.image, self.model, 2 * N, SHARP)


@pytest.fixture
def model():
    return LineModel(SCENE)


def moved(told, **values):
    bench = Bench.told(told)
    return dataclasses.replace(bench, values={**bench.values, **values})


def other_glass(told, **values):
    """Whose dispersion, none, is known to 2 %."""
    return dataclasses.replace(moved(told, dispersion_scale=0.0, **values), sigma={"dispersion_scale": 0.02})


def test_beliefs_reach_as_far_as_a_bench():
    told = numbers()
    priors = {p.name: p.prior for p in told.parameters}
    assert less_believed(told, Bench.told(told)) is told
    near = moved(told, gap_m=1e-6 + 0.9 * FAR * priors["gap_m"])
    assert less_believed(told, near) is told
    far = moved(told, gap_m=1e-6 + 6 * priors["gap_m"], ambient=8 * priors["ambient"])
    less = less_believed(told, far)
    wider = {p.name: p.prior / priors[p.name] for p in less.parameters}
    assert {name: times for name, times in wider.items() if times != 1} == {
        "gap_m": pytest.approx(6), "ambient": pytest.approx(8)
    }  # fmt: skip
    assert widened(told, less) == {"gap_m", "ambient"}
    assert less_believed(less, far) is less


def test_gap_base_and_index_are_far_together():
    told = numbers()
    priors = {p.name: p.prior for p in told.parameters}
    each = {"gap_m": 1e-6, "base_thickness_m": 3e-3, "index_offset": 0.0}
    bench = moved(told, **{name: value + 0.8 * FAR * priors[name] for name, value in each.items()})
    assert widened(told, less_believed(told, bench)) == set(each)


def test_what_the_user_says_stays():
    told = numbers(gap_m=5e-6)
    bench = moved(told, gap_m=1e-4, base_thickness_m=3.5e-3)
    assert widened(told, less_believed(told, bench)) == {"base_thickness_m"}


def test_another_dispersion_is_another_glass():
    told = numbers()
    less = less_believed(told, moved(told, dispersion_scale=0.0))
    assert widened(told, less) == {"dispersion_scale", "index_offset"}
    assert {p.name: p.prior for p in less.parameters}["index_offset"] == pytest.approx(GLASS)
    assert less_believed(less, moved(told, dispersion_scale=0.0)) is less
    known = numbers(index_offset=1e-4)
    assert widened(known, less_believed(known, moved(known, dispersion_scale=0.0))) == {"dispersion_scale"}


@pytest.mark.parametrize(
    ("scale", "sigma", "expected"),
    [(0.965, 0.005, False), (1.06, 0.005, False), (0.8, 0.01, True), (1.25, 0.01, True), (0.8, 0.1, False)],
)
def test_channels_that_mix_are_no_other_glass(scale, sigma, expected):
    """3 % from each neighbour pass for 3.5 % less dispersion, of which noise alone would know half a per cent."""
    told = numbers()
    bench = dataclasses.replace(moved(told, dispersion_scale=scale), sigma={"dispersion_scale": sigma})
    assert is_other_glass(SimpleNamespace(numbers=told, bench=bench)) == expected
    known = numbers(index_offset=1e-4)
    assert not is_other_glass(SimpleNamespace(numbers=known, bench=bench))


@pytest.mark.parametrize("name", ["base_thickness_m", "gap_m"])
def test_a_bench_far_away_is_found_by_the_number_that_differs(model, name):
    """One millimetre: a belief of 50 um ends on the way, and the other number would explain it less well."""
    told = numbers()
    image = photographed(model, **{name: Bench.told(told).values[name] + 1e-3})
    run = Run(model, image, told)
    on_told, lines_before = error_um(model, run.lines), run.lines
    nearer = GapOfLines(run.together())(run.lines, run.bench)
    together, (lines, bench) = gap_of_lines(run)
    assert nearer is not None and error_um(model, lines) < 0.1 * on_told
    assert error_um(model, lines) < 0.3 * error_um(model, nearer[0])
    apart = {key: value - told.before[key] for key, value in bench.values.items() if value != told.before[key]}
    assert set(apart) == {name} and apart[name] == pytest.approx(1e-3, rel=0.1)
    assert together.numbers == run.numbers and name in widened(told, run.numbers)
    assert run.lines is lines_before and run.bench.values == Bench.told(told).values


def test_a_gap_that_made_up_for_another_glass_is_given_back(model):
    """PMMA, whose index is the same in all colours: that shows when a gap has sent light nearly as far as it went."""
    told, plastic = numbers(), {"index_offset": 0.032, "dispersion_scale": 0.0}
    run = Run(model, photographed(model, **plastic), told)
    run.bench = other_glass(told, gap_m=6.6e-5)
    there, here = with_optical_values(SCENE, plastic), told.scene_of(run.bench.values)
    run.lines, _ = run.together().on(on_other_bench(LINES, there, here), run.bench)
    together, (lines, bench) = number_of_glass(run)
    apart = {key for key, value in bench.values.items() if value != told.before[key]}
    assert apart == {"index_offset", "dispersion_scale"}
    assert bench.values["index_offset"] == pytest.approx(0.032, abs=0.003)
    assert error_um(model, lines) < 0.15 * error_um(model, run.lines)
    assert together.numbers == run.numbers and "index_offset" in widened(told, run.numbers)
    assert "gap_m" not in widened(told, run.numbers), "which was as told all along"


def test_a_gap_stays_where_no_other_glass_was_found(model):
    """Or where the user knows the index."""
    told, known = numbers(), numbers(index_offset=1e-4)
    run = Run(model, photographed(model, gap_m=1e-4), told)
    run.bench = moved(told, gap_m=1e-4)
    assert number_of_glass(run) is None and run.numbers is told
    run.numbers, run.bench = known, other_glass(known, gap_m=1e-4)
    assert number_of_glass(run) is None and run.numbers is known
    run.numbers, run.bench = told, other_glass(told, index_offset=0.03)
    assert number_of_glass(run) is None, "it is the index that has moved"
    run.bench = dataclasses.replace(other_glass(told, gap_m=1e-4), sigma={"dispersion_scale": 0.3})
    assert number_of_glass(run) is None, "of which nothing is known"


def test_a_bench_that_is_as_told_is_left_alone(model):
    told = numbers()
    run = Run(model, photographed(model), told)
    assert gap_of_lines(run) is None and run.numbers is told


def test_a_bench_that_leaves_more_than_noise_is_believed_no_less(model, monkeypatch):
    told = numbers()
    run = Run(model, photographed(model, gap_m=1e-3), told)
    monkeypatch.setattr(less_believed_module, "CLEAN", 0.1)
    monkeypatch.setattr(less_believed_module, "MUCH_LESS", 0.0)
    _, (_, bench) = gap_of_lines(run)
    assert run.numbers is told and 5e-5 < bench.values["gap_m"] < 9e-4


def test_a_step_through_the_plate_is_no_step(model, monkeypatch):
    """Heights of a trial may cut through a base that grew thin on the way."""
    told = numbers(gap_m=4e-4, base_thickness_m=2e-4)
    run = Run(model, photographed(model, gap_m=1e-4), told)

    def cut(*_, **__):
        raise InputError("height -2e-06 m cuts through the plate")

    together = run.together()
    monkeypatch.setattr(ImageFit, "descend", cut)
    assert GapOfLines(together)(run.lines, run.bench) is None


def test_a_bench_that_is_hinted_at_is_no_bench_but_a_doubt(model, monkeypatch):
    """Of what the image says, too little to be believed."""
    told = numbers()
    run = Run(model, photographed(model, gap_m=5e-5), told)
    valley = GapOfLines(run.together())
    assert valley(run.lines, run.bench, significant=1e3) is None
    assert valley.hinted == pytest.approx(0.02, abs=0.015)
    said = iter((-0.03, 0.5 * LEAST_HINT))
    with monkeypatch.context() as patch:
        patch.setattr(GapOfLines, "__call__", lambda self, *_, **__: setattr(self, "hinted", next(said)))
        assert gap_of_lines(run) is None and run.hinted == -0.03
        assert gap_of_lines(run) is None and run.hinted == 0.0, "that much is believed of a careful user, too"
    assert gap_of_lines(Run(model, photographed(model), told)) is None
    apart = left_open_by_hint(np.full((2, 2), 4e-4), SCENE, valley.hinted)
    assert apart == pytest.approx(4e-4 * valley.hinted, rel=0.2)


def test_a_found_bench_that_leaves_more_than_noise_may_be_none():
    there = with_optical_values(SCENE, {"gap_m": 2e-4})
    heights = np.array([[0.0, 4e-4], [8e-4, 0.0]])
    apart = left_open_by_unclear_bench(heights, SCENE, there, 1.5)
    on_told = ThinRelief.of(SCENE).unbent(ThinRelief.of(there).bent(heights))
    np.testing.assert_allclose(apart, UNCLEAR_SHARE * (on_told - heights))
    np.testing.assert_allclose(left_open_by_unclear_bench(heights, SCENE, there, NO_BENCH), on_told - heights)
    assert (apart[heights > 0] > 0.015 * heights[heights > 0]).all()
    assert not left_open_by_unclear_bench(heights, there, there, NO_BENCH).any()
