"""How far light goes, told by lines that explain the image on the told bench nearly as well; on a small scene."""

import dataclasses
import math

import numpy as np
import pytest
import torch

from nets.reconstruct.fibres.bench.bench_and_light import BEND_LIGHT, Bench
from nets.reconstruct.fibres.bench.bench_of_lines import BenchOfLines, numbers_of_lines
from nets.reconstruct.fibres.bench.gap_of_lines import (
    FARTHER,
    FIRST_STEP,
    GapOfLines,
    Trial,
    along,
    by_number,
    likeliest,
    on_other_bench,
    told_between,
)
from nets.reconstruct.fibres.bench.least_of_valley import MOST_STEPS, bracketed, vertex
from nets.reconstruct.fibres.image.image_fit import ImageFit
from tests.nets.reconstruct.exact_light import light_of
from warp_caustics.found_bench.bench_numbers import BenchNumbers
from warp_caustics.found_bench.thin_relief import ThinRelief
from warp_caustics.prints.line_shape import Shape
from warp_caustics.prints.model import HEIGHT, LineModel
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.scene import Scene
from warp_caustics.setup.optical import with_optical_values

N = 48
SCENE = Scene(height_samples=N, image_pixels=4 * N)
LINES = 1e-3 * torch.tensor(
    [
        [-15.0, -12.0, 14.0, 9.0, 4.0, 0.9],
        [-9.0, 15.0, 10.0, -16.0, 3.2, 1.2],
        [-18.0, 5.0, 12.0, 16.0, 3.6, 1.0],
    ],
    dtype=torch.float64,
)
NOISE = 0.005
SHARP = ChannelCamera.perfect(3, SCENE.image_pixels)
GAP_M = 1e-4
"""More than told, two prior widths: heights 5 % too high on the told bench."""


@pytest.fixture(scope="module")
def model():
    return LineModel(SCENE)


def numbers(**priors):
    return numbers_of_lines(BenchNumbers.of(SCENE, priors))


def photographed(model, **values):
    """Lines on a bench, with noise."""
    shown = light_of(with_optical_values(SCENE, values), model.heights(LINES)).numpy()
    noise = NOISE * np.random.default_rng(0).standard_normal(shown.shape)
    return CausticImage((shown + noise).astype(np.float32), np.full(3, NOISE))


def on_told_bench(model, image):
    """Lines that explain an image there as well as they can."""
    return ImageFit(SCENE, image, model, 4 * N).descend(LINES, 40).lines


def error_um(model, lines):
    return 1e6 * float((model.heights(lines) - model.heights(LINES)).square().mean().sqrt())


def found(model, image, told, report=None):
    search = GapOfLines(BenchOfLines(told, image, model, 2 * N, SHARP, report=report))
    return search(on_told_bench(model, image), Bench.told(told))


@pytest.mark.parametrize("more_m", [GAP_M, -GAP_M])
def test_lines_find_their_way_along_the_valley(model, more_m):
    """Wider it is the gap that moves; closer than the glass no screen can be, and the base is thinner."""
    # What is believed pulls on what so small a plate tells.
    told = numbers(gap_m=4e-4, base_thickness_m=2e-4)
    image = photographed(model, base_thickness_m=3e-3 + 1.4585 * more_m)
    wrong = on_told_bench(model, image)
    lines, bench = found(model, image, told)
    assert error_um(model, wrong) > 8 and error_um(model, lines) < 0.3 * error_um(model, wrong)
    before = Bench.told(told).values
    throw = bench.values["gap_m"] + (bench.values["base_thickness_m"] - before["base_thickness_m"]) / 1.4585
    assert throw == pytest.approx(before["gap_m"] + more_m, abs=2e-5)
    if more_m > 0:
        assert bench.values["base_thickness_m"] == before["base_thickness_m"]
    else:
        assert bench.values["gap_m"] == 0.0
    assert {name for name in before if bench.values[name] != before[name]} <= {"gap_m", "base_thickness_m"}


def test_a_bench_that_is_as_told_is_left_alone_after_a_step_to_either_side(model):
    asked = []
    assert found(model, photographed(model), numbers(), asked.append) is None
    assert 0 < len(asked) < 50 and model.shape == Shape(1.0)


def test_the_least_between_two_steps_is_looked_at(model):
    """A third of a step wider: a step to either side leaves more than none."""
    share = FIRST_STEP / 3
    told = numbers(gap_m=4e-4, base_thickness_m=1e-6, index_offset=1e-6)
    image = photographed(model, gap_m=1e-6 + share * ThinRelief.of(SCENE).linear / (SCENE.glass_indices[1] - 1))
    wrong = on_told_bench(model, image)
    search = GapOfLines(BenchOfLines(told, image, model, 2 * N, SHARP))
    lines, bench = search(wrong, Bench.told(told), significant=FARTHER)
    assert error_um(model, lines) < 0.6 * error_um(model, wrong)
    assert search.told[0] == pytest.approx(share, abs=2 * search.told[1]) and 0 < search.told[1] < share
    assert 0 < bench.values["gap_m"] - 1e-6 < FIRST_STEP * ThinRelief.of(SCENE).linear


def test_what_lines_tell_of_a_bench_as_told_is_kept(model):
    search = GapOfLines(BenchOfLines(numbers(), photographed(model), model, 2 * N, SHARP))
    assert search.told is None
    assert search(on_told_bench(model, photographed(model)), Bench.told(numbers())) is None
    assert abs(search.told[0]) < 3 * search.told[1] < 3 * FIRST_STEP


@pytest.mark.parametrize("alone", [{"base_thickness_m": 3.14e-3}, {"gap_m": 6.8e-5}, {"index_offset": -0.01}])
def test_each_has_its_likely_part_of_the_way(alone):
    """Of all benches with that (n - 1) D none has a smaller sum of squares of deviations; a gap is none below 0."""
    told = numbers()
    bench = dataclasses.replace(Bench.told(told), values={**Bench.told(told).values, **alone})
    likely = likeliest(told, bench)
    there, here = (ThinRelief.of(told.scene_of(each.values)).linear for each in (likely, bench))
    assert there == pytest.approx(here, rel=2e-4)
    free = [p for p in told.parameters if p.name in BEND_LIGHT]

    def far(at):
        return sum(((at.values[p.name] - told.before[p.name]) / p.prior) ** 2 for p in free)

    assert far(likely) < far(bench)
    for p in free:
        for by in (-0.1 * p.prior, 0.1 * p.prior):
            moved = dataclasses.replace(
                likely, values=likely.values | told.within({p.name: likely.values[p.name] + by})
            )
            assert far(likely) <= far(back_on(told, moved, there, p.name)) + 1e-3
    assert likely.values["gap_m"] >= 0


def back_on(told, bench, linear, kept):
    """A bench with the way of another, by one of the numbers that were not moved."""
    other = next(p for p in told.parameters if p.name in BEND_LIGHT and p.name not in (kept, "gap_m"))
    rest = linear - ThinRelief.of(told.scene_of(bench.values)).linear
    value = bench.values[other.name] + rest / by_number(told, bench, other)
    return dataclasses.replace(bench, values={**bench.values, other.name: value})


def test_a_gap_that_is_known_is_not_looked_for(model):
    image = photographed(model, gap_m=1e-6 + GAP_M)
    _, bench = found(model, image, numbers(gap_m=0.0))
    assert "gap_m" not in bench.values and bench.values["base_thickness_m"] > 3.1e-3
    exactly = numbers(gap_m=0.0, base_thickness_m=0.0, index_offset=0.0)
    asked = []
    assert found(model, image, exactly, asked.append) is None and not asked
    # To a tenth of a micrometre each, and to 1e-7: that the image says otherwise is not enough.
    assert found(model, image, numbers(gap_m=1e-7, base_thickness_m=1e-7, index_offset=1e-7)) is None


def test_an_interrupted_search_leaves_the_section(model):
    image, calls = photographed(model, gap_m=1e-6 + GAP_M), []

    def stop(loss):
        calls.append(loss)
        if len(calls) > 20:
            raise KeyboardInterrupt

    search = GapOfLines(BenchOfLines(numbers(), image, model, 2 * N, SHARP, with_section=True, report=stop))
    with pytest.raises(KeyboardInterrupt):
        search(on_told_bench(model, image), Bench.told(numbers()))
    assert model.shape == Shape(1.0)


def test_heights_follow_a_bench_in_closed_form():
    there = with_optical_values(SCENE, {"gap_m": 2e-4, "index_offset": 1e-3})
    moved = on_other_bench(LINES, SCENE, there)
    heights, were = (each[:, HEIGHT].numpy() for each in (moved, LINES))
    np.testing.assert_allclose(ThinRelief.of(there).bent(heights), ThinRelief.of(SCENE).bent(were), rtol=1e-12)
    assert (heights < were).all() and torch.equal(moved[:, :HEIGHT], LINES[:, :HEIGHT])


@pytest.mark.parametrize("priors", [{}, {"gap_m": 1e-6}, {"gap_m": 0.0, "base_thickness_m": 0.0}])
@pytest.mark.parametrize("share", [-0.01, 0.03])
def test_what_is_believed_least_moves(priors, share):
    told = numbers(**priors)
    bench = along(told, Bench.told(told), share)
    there, here = (ThinRelief.of(told.scene_of(each.values)).linear for each in (bench, Bench.told(told)))
    assert there / here == pytest.approx(1 + share, abs=0.02 * abs(share))
    is_moved = {name for name, value in bench.values.items() if value != told.before[name]}
    if "gap_m" not in told.names:
        assert is_moved == {"index_offset"}
    elif priors:
        assert is_moved == {"base_thickness_m"}
    else:
        assert is_moved == ({"gap_m"} if share > 0 else {"gap_m", "base_thickness_m"})


def test_vertex_of_a_parabola():
    def at(share):
        return Trial(share, Bench({}, np.zeros(0)), LINES, Shape(1.0), 2 + 3 * (share - 0.4) ** 2)

    assert vertex(at(0.1), at(0.3), at(0.9)) == (pytest.approx(0.4), pytest.approx(6.0))
    left, middle, right = at(0.0), at(FIRST_STEP), at(2 * FIRST_STEP)
    assert vertex(left, dataclasses.replace(middle, loss=9.0), right)[1] == 0.0


def test_what_three_trials_tell():
    """Of 2 + 3 (t - 0.1)^2 the least is at 0.1, and half a square of a deviation is a weight: 3 s^2 = w / 2."""

    def at(share, loss=None):
        value = 2 + 3 * (share - 0.1) ** 2 if loss is None else loss
        return Trial(share, Bench({}, np.zeros(0)), LINES, Shape(1.0), value)

    told = told_between((at(-0.5), at(0.5)), at(0.0), 0.06)
    assert told == (pytest.approx(0.1), pytest.approx(0.1))
    assert told_between((at(-0.5, np.inf), at(0.5)), at(0.0), 0.06) is None
    assert told_between((at(-0.5), at(0.5)), at(0.0, 9.0), 0.06) is None


@pytest.mark.parametrize("least", [0.3, -0.3, 40.0])
def test_steps_that_grow_go_downhill(least):
    """To either side; None where the least is farther than they go."""

    def at(share):
        return Trial(share, Bench({}, np.zeros(0)), LINES, Shape(1.0), abs(share - least))

    step = math.copysign(0.1, least)
    three = bracketed(lambda near, share: at(share), at(0.0), at(step))
    if abs(least) > abs(step) * (2**MOST_STEPS - 1):
        assert three is None
        return
    left, middle, right = three
    assert left.share < least < right.share and middle.loss == min(each.loss for each in three)
    assert sorted(abs(each.share) for each in three) == pytest.approx([0.1, 0.3, 0.7])
