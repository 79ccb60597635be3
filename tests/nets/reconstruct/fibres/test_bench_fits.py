"""The fewest numbers of a bench that explain an image."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from nets.reconstruct.fibres.bench import bench_fits, gap_fits, less_believed
from nets.reconstruct.fibres.bench.bench_and_light import BEND_LIGHT, Bench, bench_record, lit, seen_on
from nets.reconstruct.fibres.bench.bench_fits import (
    asked_next,
    differing,
    fit_with_bench,
    fit_with_other_place,
    fit_with_place,
    in_turn,
)
from nets.reconstruct.fibres.bench.bench_of_lines import BenchOfLines, numbers_of_lines
from nets.reconstruct.fibres.bench.gap_fits import deviations_asked, fit_with_every_number, fit_with_gap
from nets.reconstruct.fibres.bench.gap_of_lines import likeliest
from nets.reconstruct.fibres.bench.light_of_lines import fit_with_light
from nets.reconstruct.fibres.bench.line_posterior import JointCovariance
from nets.reconstruct.fibres.image.image_fit import ImageFit
from nets.reconstruct.fibres.image.lines_view import LinesView
from tests.nets.reconstruct.exact_light import light_of
from tests.nets.reconstruct.fibres.three_lines import LINES, SCENE, error_um
from warp_caustics.found_bench.bench_numbers import BenchNumbers
from warp_caustics.found_bench.bench_record import SIGNIFICANT
from warp_caustics.prints.model import LineModel
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.result import Resimulation
from warp_caustics.reconstruct.seen_camera.pixel_means import Lay, pixel_means
from warp_caustics.reconstruct.seen_camera.point_spread import FineLight
from warp_caustics.setup.optical import with_optical_values
from warp_caustics.simulator import CausticSimulator
from warp_caustics.way_of_light import way_of_light_m

NOISE = 0.005
NUMBERS = numbers_of_lines(BenchNumbers.of(SCENE))


@pytest.fixture(scope="module")
def model():
    return LineModel(SCENE)


def photographed(model, bench):
    optical = {name: value for name, value in bench.values.items() if name != "ambient"}
    shown = light_of(with_optical_values(SCENE, optical), model.heights(LINES)).numpy()
    measured = lit(shown.astype(np.float64), NUMBERS, bench, np.ones(3))
    noise = NOISE * np.random.default_rng(0).standard_normal(shown.shape)
    return CausticImage((measured + noise).astype(np.float32), np.full(3, NOISE))


def bench_with(slope=0.0, **values):
    told = Bench.told(NUMBERS)
    field = np.zeros(len(told.field))
    field[3] = slope
    return Bench({**told.values, **values}, field)


def run_with(model, image, lines):
    view = LinesView(Resimulation(CausticSimulator(SCENE), image), model)
    run = SimpleNamespace(model=model, lines=lines, view=view, told=view, bench=Bench.told(NUMBERS), numbers=NUMBERS)
    run.covariance, run.counted, run.asked = None, None, NUMBERS.names
    run.moves_section = run.is_elsewhere = False
    run.hinted = 0.0
    run.search, run.searched = lambda start, jumps: run.searched.append(jumps), []

    def on(bench):
        simulator = CausticSimulator(run.numbers.scene_of(bench.values))
        return LinesView(Resimulation(simulator, seen_on(image, run.numbers, bench)), model)

    def together(names=None):
        numbers = run.numbers if names is None else run.numbers.only(names)
        return BenchOfLines(numbers, run.told.image, model, SCENE.image_pixels // 2, run.view.camera)

    run.on, run.together = on, together
    return run


def test_numbers_are_asked_in_turn():
    names = ("dispersion_scale", "screen_x_m", "ambient", "tilt_x_rad", "gap_m")
    assert in_turn(names) == [names[1:3], names[:4], names]
    assert in_turn(("screen_x_m",)) == [("screen_x_m",)] and in_turn(("gap_m",)) == [("gap_m",)] and in_turn(()) == []
    assert in_turn(("screen_x_m", "gap_m")) == [("screen_x_m",), ("screen_x_m", "gap_m")]


def test_a_picture_that_lies_aside_is_no_other_bench(model):
    """All numbers together end further from the truth."""
    image = photographed(model, bench_with(screen_x_m=1.5e-4))
    run = run_with(model, image, LINES + 2e-5)
    fit_with_bench(run)
    assert run.view.is_explained(run.lines) and run.asked == ("screen_x_m",) and not run.searched
    assert run.bench.values["screen_x_m"] == pytest.approx(1.5e-4, abs=2e-6)
    assert {name for name, value in run.bench.values.items() if value != NUMBERS.before[name]} == {"screen_x_m"}
    assert run.bench.sigma.keys() == {"screen_x_m", "screen_y_m", "vergence_per_m", "ambient"}
    verdicts = {number.name: number.verdict for number in bench_record(NUMBERS, run.bench).numbers}
    assert verdicts["screen_x_m"] == "found" and verdicts["screen_y_m"] == "as told"
    assert verdicts["gap_m"] == verdicts["tilt_x_rad"] == "not told by this image"
    assert "dispersion_scale" not in verdicts, "which had not to be asked"
    assert run.covariance.matrix.shape[0] == LINES.numel() + 1 + len(run.bench.field)
    assert error_um(model, run.lines) < 0.4
    lines, bench = run.together()(LINES + 2e-5, Bench.told(NUMBERS))
    assert error_um(model, lines) > 1.5 * error_um(model, run.lines)
    assert bench.values["gap_m"] != NUMBERS.before["gap_m"]


def test_a_picture_that_lies_aside_is_found_by_what_moves_it(model):
    """Beside lines that have gone with it; lines that leave nothing but noise are not asked again."""
    run = run_with(model, photographed(model, bench_with(screen_x_m=1.5e-4)), LINES + 2e-5)
    fit_with_place(run)
    assert run.view.is_settled(run.lines) and error_um(model, run.lines) < 0.4
    assert run.bench.values["screen_x_m"] == pytest.approx(1.5e-4, abs=2e-6)
    assert set(run.asked) == set(in_turn(NUMBERS.names)[0])
    bench = run.bench
    fit_with_place(run)
    assert run.bench is bench


def test_a_picture_behind_another_gap_is_not_asked_for_its_place(model):
    run = run_with(model, photographed(model, bench_with(gap_m=1e-3)), LINES)
    lines = run.lines = run.together().on(LINES, run.bench)[0]
    bench = run.bench
    assert not run.view.is_settled(lines)
    fit_with_place(run)
    assert run.lines is lines and run.bench is bench


@pytest.mark.parametrize("is_better", [True, False])
def test_lines_that_are_wrong_in_a_place_on_another_bench_are_searched_for_again(model, monkeypatch, is_better):
    """Though they leave no more than noise in the mean; what is found is kept where it leaves less."""
    run = run_with(model, photographed(model, bench_with(screen_x_m=1.5e-4)), LINES + 5e-6)
    found = LINES.clone() if is_better else LINES + 3e-5
    monkeypatch.setattr(LinesView, "is_wrong_in_places", lambda self, lines: lines is not found)

    def search(start, jumps):
        run.searched.append(jumps)
        assert run.view.is_explained(start)
        run.lines = found

    run.search = search
    fit_with_bench(run)
    assert run.searched and set(run.searched) == {1}
    assert run.bench.values["screen_x_m"] == pytest.approx(1.5e-4, abs=5e-6)
    assert error_um(model, run.lines) < 1.0 < error_um(model, LINES + 3e-5)


def test_lines_say_whether_another_bench_would_explain_more(model):
    """Of those that leave hardly more than noise, too, and which numbers tell it: the truth asks for none."""
    turns = in_turn(NUMBERS.names)
    for bench, asked in (
        (bench_with(), None),
        (bench_with(tilt_x_rad=0.0035), 0),
        (bench_with(dispersion_scale=0.3), 1),
    ):
        run = run_with(model, photographed(model, bench), LINES)
        run.lines, _ = run.together().on(run.lines, run.bench)
        assert run.view.is_explained(run.lines)
        evidence = run.together().evidence(run.lines, run.bench, turns)
        assert evidence == sorted(evidence) and (evidence[-1] < 4.0 if asked is None else evidence[-1] > 40.0)
        names, later = asked_next(run, turns)
        assert names == (None if asked is None else turns[asked])
        assert list(later) == ([] if asked is None else turns[asked + 1 :])


def test_light_from_aside_is_told_by_lines(model):
    """Where the picture does not lie aside: by how much what is high lies farther from its place than what is low."""
    bench = bench_with(tilt_x_rad=0.03)
    run = run_with(model, photographed(model, bench), LINES)
    run.numbers = NUMBERS.only([name for name in NUMBERS.names if not name.startswith("screen")])
    run.bench = Bench({name: NUMBERS.before[name] for name in run.numbers.names}, Bench.told(NUMBERS).field)
    fit_with_bench(run)
    assert run.bench.values["tilt_x_rad"] == pytest.approx(0.03, abs=0.002) and "tilt_x_rad" in run.asked
    assert error_um(model, run.lines) < 1.0


def test_a_slant_that_was_taken_for_a_move_is_found(model):
    """Lines on a screen that was moved by as much explain the image, and no step leads away from there."""
    slant = 0.03
    run = run_with(model, photographed(model, bench_with(tilt_x_rad=slant)), LINES)
    aside = way_of_light_m(SCENE) * math.tan(slant)
    moved = run.together(["screen_x_m", "screen_y_m"])
    run.lines, run.bench = moved(LINES, bench_with(screen_x_m=-aside))
    run.view, run.asked = run.on(run.bench), moved.numbers.names
    assert run.view.is_explained(run.lines) and run.bench.values["screen_x_m"] == pytest.approx(-aside, rel=0.3)
    assert fit_with_other_place(run) is not None and "tilt_x_rad" in run.asked
    assert run.bench.values["tilt_x_rad"] == pytest.approx(slant, abs=4e-3)
    assert abs(run.bench.values["screen_x_m"]) < 0.2 * aside
    assert fit_with_other_place(run) is None


@pytest.mark.parametrize(("is_picture", "is_taken_for"), [(True, False), (False, False), (False, True)])
def test_a_picture_that_is_too_large_is_told_from_a_lamp_nearby(model, is_picture, is_taken_for):
    """By what is high, which a lamp enlarges more; pictures met the pixels before they were brought back.

    Whatever it was taken for without lines.
    """
    vergence = 4.0
    image = photographed(model, bench_with(vergence_per_m=vergence))
    if is_picture:
        fine = FineLight(CausticSimulator(SCENE))(model.heights(LINES))
        lay = Lay(size=1 + way_of_light_m(SCENE) * vergence, is_back=False)
        shown = torch.stack([pixel_means(light, SCENE.image_pixels, lay=lay) for light in fine]).numpy()
        noise = NOISE * np.random.default_rng(0).standard_normal(shown.shape)
        image = CausticImage((shown + noise).astype(np.float32), np.full(3, NOISE))
    run = run_with(model, image, LINES + 1e-5)
    if is_taken_for:
        run.numbers = numbers_of_lines(BenchNumbers.of(SCENE).of_picture())
    fit_with_bench(run)
    assert run.numbers.is_picture == is_picture and run.view.is_explained(run.lines)
    assert run.bench.values["vergence_per_m"] == pytest.approx(vergence, abs=0.1)
    assert error_um(model, run.lines) < 1.0
    assert bench_record(run.numbers, run.bench).is_picture == is_picture
    assert not is_picture or set(run.asked).isdisjoint(BEND_LIGHT), (
        "which such a picture is not simulated well enough for"
    )


def test_gap_and_base_of_a_picture_of_another_size_must_tell_more_than_is_simulated_wrong(model, monkeypatch):
    """Of one that lines explain, by how much noise hides of that."""
    run = run_with(model, photographed(model, bench_with()), LINES)
    said = 100.0
    monkeypatch.setattr(BenchOfLines, "evidence", lambda self, lines, bench, some: [said] * len(some))
    turns = in_turn(run.numbers.names)
    assert asked_next(run, turns[-1:])[0] == turns[-1]
    run.numbers = replace(run.numbers, is_picture=True)
    assert deviations_asked(run, 3.0) == pytest.approx(3.0 + 23.0 * 2e-3 / NOISE, rel=0.05)
    assert asked_next(run, turns[-1:]) == (None, [])
    assert asked_next(run, turns)[0] == turns[0]
    asked = []
    monkeypatch.setattr(gap_fits, "gap_of_lines", lambda run, significant: asked.append(significant))
    fit_with_gap(run)
    assert asked == [deviations_asked(run, SIGNIFICANT)]
    said = 200.0
    assert asked_next(run, turns[-1:])[0] == turns[-1], "clearly more"
    said, run.lines = 100.0, LINES[:1]
    assert asked_next(run, turns[-1:])[0] == turns[-1], "of one that they do not explain they are asked"


def test_a_bench_that_was_found_without_lines_and_cannot_be_bettered_is_known_as_well(model, monkeypatch):
    """Lines may be where all numbers together leave least already; what noise makes of both is told all the same."""
    bench = bench_with(ambient=0.05)
    run = run_with(model, photographed(model, bench), LINES)
    run.bench, run.is_elsewhere = bench, True
    run.view = run.on(bench)
    monkeypatch.setattr(bench_fits, "_fit_with_numbers", lambda run, names: None)
    fit_with_bench(run)
    assert run.covariance is not None and run.counted is run.lines
    assert run.bench.values["ambient"] == pytest.approx(0.05, abs=0.002)
    assert len(run.covariance.matrix) == LINES.numel() + len(run.asked) + len(run.bench.field)


def test_another_glass_is_found_by_its_colours_and_then_its_index(model):
    """BK7 of the same index in all colours: all numbers together end between gap, base and index, none of them right."""
    glass = {"index_offset": 0.0583, "dispersion_scale": 0.0}
    image = photographed(model, bench_with(**glass))
    run = run_with(model, image, ImageFit(SCENE, image, model, SCENE.image_pixels).descend(LINES, 40).lines)
    before = error_um(model, run.lines)
    fit_with_bench(run)
    assert run.bench.values["index_offset"] == pytest.approx(0.0583, abs=0.02), "as so small an image tells it"
    assert run.bench.values["gap_m"] == NUMBERS.before["gap_m"]
    assert error_um(model, run.lines) < 0.35 * before


def test_a_gap_that_stands_for_base_and_index_is_not_held_back_by_them(model):
    """Light goes farther by all three; of a gap alone, found half of the way, all numbers together go on."""
    other = {"gap_m": 5e-5, "base_thickness_m": 3.02e-3, "index_offset": 7e-4}
    image = photographed(model, bench_with(**other))
    run = run_with(model, image, LINES)
    run.numbers = less_believed.less_believed(NUMBERS, bench_with(gap_m=6e-5))
    run.bench = bench_with(gap_m=3e-5)
    run.lines, _ = run.together().on(LINES, run.bench)
    run.view = run.on(run.bench)
    before, left = error_um(model, run.lines), run.view.left(run.lines)
    fit_with_every_number(run)
    assert run.view.left(run.lines) < left and set(run.asked) == set(NUMBERS.names)
    assert error_um(model, run.lines) < 0.5 * before


@pytest.mark.parametrize(("thicker_m", "starts"), [(1.4e-4, 2), (3e-5, 1)])
def test_a_base_that_was_taken_for_all_is_asked_again_with_its_likely_part(model, monkeypatch, thicker_m, starts):
    """Five deviations of what is believed are unlikely, one is not; nothing is kept that leaves no less."""
    run, asked = run_with(model, photographed(model, bench_with()), LINES), []
    run.bench = bench_with(base_thickness_m=3e-3 + thicker_m)
    run.numbers = less_believed.less_believed(NUMBERS, run.bench)
    believed = run.numbers

    def same(together, lines, bench):
        asked.append((together.numbers, bench))
        return lines, bench

    monkeypatch.setattr(gap_fits, "with_valley", same)
    bench = run.bench
    fit_with_every_number(run)
    assert len(asked) == starts and asked[0] == (believed, bench)
    if starts == 2:
        usual, likely = asked[1]
        assert [p.prior for p in usual.parameters] == [p.prior for p in NUMBERS.parameters]
        assert likely.values == likeliest(NUMBERS, bench).values
        assert likely.values["gap_m"] > 7e-5 > 2.5e-5 > likely.values["base_thickness_m"] - 3e-3
    assert run.numbers is believed


@pytest.mark.parametrize("glass", [{}, {"index_offset": 0.05, "dispersion_scale": 0.0}])
def test_a_bench_as_told_and_another_glass_are_left_as_they_were_found(model, glass):
    run = run_with(model, photographed(model, bench_with()), LINES)
    run.bench = replace(bench_with(screen_x_m=1e-5, **glass), sigma={"dispersion_scale": 0.1})
    run.together = lambda names=None: pytest.fail("asked")
    bench = run.bench
    fit_with_every_number(run)
    assert run.bench is bench


def test_light_that_is_uneven_needs_no_other_bench(model):
    image = photographed(model, bench_with(0.04))
    run = run_with(model, image, LINES + 1e-6)
    before = error_um(model, LINES + 1e-6)
    fit_with_light(run)
    assert run.bench.field[3] == pytest.approx(0.04, abs=0.003)
    assert run.bench.uneven(64) == pytest.approx(0.08, abs=0.006)
    changed = {name for name, value in run.bench.values.items() if value != NUMBERS.before[name]}
    assert changed <= {"ambient"} and abs(run.bench.values["ambient"]) < 0.003
    assert error_um(model, run.lines) < before and run.covariance is None


def test_even_light_is_not_asked(model, monkeypatch):
    run = run_with(model, photographed(model, bench_with()), LINES)
    monkeypatch.setattr(BenchOfLines, "__call__", lambda *_: pytest.fail("asked"))
    lines, view = run.lines, run.view
    fit_with_light(run)
    assert run.lines is lines and run.view is view


def test_a_bench_that_explains_no_more_is_left(model, monkeypatch):
    """And nothing is searched for on it."""
    image = photographed(model, bench_with())
    wrong = LINES[:1]
    run = run_with(model, image, wrong)
    moved = bench_with(screen_x_m=1e-6)
    monkeypatch.setattr(less_believed, "with_valley", lambda together, lines, bench: (lines, moved))
    fit_with_bench(run)
    assert run.lines is wrong and run.bench.is_told(NUMBERS) and run.covariance is None
    assert run.searched == [1], "but on the last, of all numbers"


def test_numbers_that_hang_together_differ_together():
    """Gap and base are known as one: both within their deviations, but not as told."""
    numbers = NUMBERS.only(("screen_x_m", "gap_m", "base_thickness_m"))
    together = SimpleNamespace(numbers=numbers, n_beside=3 + 8)
    widths = {p.name: p.prior for p in numbers.parameters}
    order = numbers.names
    block = np.zeros((3, 3))
    g, b, s = order.index("gap_m"), order.index("base_thickness_m"), order.index("screen_x_m")
    block[g, g] = block[b, b] = 0.25
    block[g, b] = block[b, g] = -0.2499
    block[s, s] = 1e-4
    matrix = np.eye(18 + 11)
    matrix[18:21, 18:21] = block
    values = {name: NUMBERS.before[name] + 0.5 * widths[name] for name in ("gap_m", "base_thickness_m")}
    bench = bench_with(**values)
    assert len(differing(together, bench, JointCovariance(matrix))) == 1
    opposite = bench_with(gap_m=values["gap_m"], base_thickness_m=3e-3 - 0.5 * widths["base_thickness_m"])
    assert differing(together, opposite, JointCovariance(matrix)) == (), "which shows as much as nothing"
    aside = bench_with(screen_x_m=0.05 * widths["screen_x_m"])
    assert differing(together, aside, JointCovariance(matrix)) == ("screen_x_m",)


def test_an_interrupted_fit_changes_nothing(model):
    image = photographed(model, bench_with(screen_x_m=1.5e-4))
    run = run_with(model, image, LINES + 2e-5)

    def stop(names=None):
        raise KeyboardInterrupt

    run.together, lines, view = stop, run.lines, run.view
    with pytest.raises(KeyboardInterrupt):
        fit_with_bench(run)
    assert run.lines is lines and run.view is view and run.numbers is NUMBERS
    assert torch.equal(run.lines, lines)
