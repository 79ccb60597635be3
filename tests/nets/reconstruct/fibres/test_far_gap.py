"""Benches on which light goes much farther than was told, by what lines leave at few pixels."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from nets.reconstruct.fibres.bench import far_gap
from nets.reconstruct.fibres.bench.far_gap import farther, fit_far_away, mapped
from nets.reconstruct.fibres.bench.gap_of_lines import on_other_bench
from nets.reconstruct.fibres.image.image_fit import ImageFit
from nets.reconstruct.fibres.search.line_search import Answer
from tests.nets.reconstruct.fibres.test_bench_fits import NUMBERS, bench_with, photographed, run_with
from tests.nets.reconstruct.fibres.three_lines import LINES, SCENE, N, error_um
from warp_caustics.found_bench.thin_relief import ThinRelief
from warp_caustics.prints.model import LineModel

FEW = 2 * N
FAR_M = 1.2e-3
"""Of air where none was told: light goes 58 % farther."""
FARTHER_M = 3e-3
"""Two and a half times as far: lines on the told bench leave six times the noise, of 1.2 mm 1.8 times."""


@pytest.fixture(scope="module")
def model():
    return LineModel(SCENE)


def nearly(model, bench):
    """A run whose lines explain an image on the told bench as well as they can."""
    image = photographed(model, bench)
    there = NUMBERS.scene_of(bench.values)
    start = model.clamped(on_other_bench(LINES, there, SCENE))
    lines = ImageFit(SCENE, image, model, FEW).descend(start, 30).lines
    return run_with(model, image, lines)


def linear(bench):
    return ThinRelief.of(NUMBERS.scene_of(bench.values)).linear


@pytest.mark.parametrize("others", [{"gap_m": FAR_M}, {"base_thickness_m": 2e-3}])
def test_light_that_goes_much_farther_or_less_far_is_found(model, others):
    bench = bench_with(**others)
    run = nearly(model, bench)
    found = farther(run, FEW)
    told, true = linear(run.bench), linear(bench)
    # Within a step and a half of the ladder, from 58 % and 33 % away.
    assert abs(np.log(linear(found.bench) / true)) < 1.5 * np.log(far_gap.STEP) < abs(np.log(told / true))
    assert error_um(model, found.lines) < 0.5 * error_um(model, run.lines)
    (moved,) = found.bench.sigma
    assert 0 < found.bench.sigma[moved] < abs(found.bench.values[moved] - run.bench.values[moved])
    assert run.bench.is_told(NUMBERS) and not run.bench.sigma, "the run stays"


def test_a_bench_that_is_as_told_is_left(model):
    assert farther(nearly(model, bench_with()), FEW) is None


def test_no_bench_is_asked_whose_numbers_are_known(model):
    run = nearly(model, bench_with(gap_m=FAR_M))
    run.numbers = NUMBERS.only({"screen_x_m"})
    assert farther(run, FEW) is None


def test_glass_that_was_found_in_place_of_a_gap_is_as_told_from_there(model):
    run = nearly(model, bench_with(gap_m=FAR_M))
    run.bench = bench_with(dispersion_scale=1.6)
    assert farther(run, FEW).bench.values["dispersion_scale"] == 1.0


def asking(run, explains):
    """A run as a method has it, whose search ends where it begins or spoils what was found."""
    options = SimpleNamespace(pixels_on=lambda device, scene: 2 * FEW)
    run.method = SimpleNamespace(
        takes_bench_as_told=False, options=SimpleNamespace(pixels_on=options.pixels_on, jumps=1),
        device=torch.device("cpu"), scene=SCENE,
    )  # fmt: skip
    heights = run.model.heights(run.lines)
    run.said, run.is_in_vain, on = Answer(heights, torch.full_like(heights, 1e-6)), True, run.on
    run.on = lambda bench, camera: on(bench)

    def search(start, jumps, *, is_first):
        run.searched.append((jumps, is_first))
        run.is_in_vain = False
        if not explains:
            run.lines = start[:1]

    run.search = search
    return run


@pytest.mark.parametrize("explains", [True, False])
def test_lines_are_searched_for_there_and_stay_where_they_do_no_better(model, explains):
    run = asking(nearly(model, bench_with(gap_m=FARTHER_M)), explains)
    lines, said, bench = run.lines, run.said, run.bench
    fit_far_away(run)
    assert run.searched == [(1, True)]
    if explains:
        assert linear(run.bench) > 1.2 * linear(bench) and error_um(model, run.lines) < 0.5 * error_um(model, lines)
        assert run.said.relief_m.max() < 0.9 * said.relief_m.max() and not run.is_in_vain
    else:
        assert run.bench is bench and run.lines is lines and run.said is said and run.is_in_vain


def test_who_says_that_the_bench_is_as_told_is_not_asked(model):
    run = asking(nearly(model, bench_with(gap_m=FARTHER_M)), explains=True)
    run.method.takes_bench_as_told = True
    fit_far_away(run)
    assert not run.searched
    run = asking(nearly(model, bench_with()), explains=True)
    fit_far_away(run)
    assert not run.searched, "lines that explain the image"


def test_what_a_network_said_sends_light_where_it_did():
    there = NUMBERS.scene_of(bench_with(gap_m=FAR_M).values)
    heights = torch.linspace(0, 1e-3, 50, dtype=torch.float64).reshape(5, 10)
    moved = mapped(Answer(heights, 1e-5 * torch.ones_like(heights), 7), SCENE, there)
    near, far = ThinRelief.of(SCENE), ThinRelief.of(there)
    np.testing.assert_allclose(far.bent(moved.relief_m.numpy()), near.bent(heights.numpy()), rtol=1e-12)
    # What it is unsure of moves along: by differences.
    again = mapped(Answer(heights + 1e-8, torch.zeros_like(heights)), SCENE, there)
    slope = (again.relief_m - moved.relief_m) / 1e-8
    np.testing.assert_allclose(moved.spread_m.numpy(), 1e-5 * slope.numpy(), rtol=1e-3)
    assert moved.most == 7
