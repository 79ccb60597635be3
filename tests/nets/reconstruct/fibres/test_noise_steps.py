"""Steps of lines and bench that nothing but an image's noise holds."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from nets.reconstruct.fibres import lines_of_image
from nets.reconstruct.fibres.bench import lens_numbers, noise_bench, noise_steps
from nets.reconstruct.fibres.bench.bench_and_light import ShownLight
from nets.reconstruct.fibres.bench.gap_fits import is_open
from nets.reconstruct.fibres.bench.gap_of_lines import on_other_bench
from nets.reconstruct.fibres.bench.noise_fits import fit_by_noise
from nets.reconstruct.fibres.bench.noise_place import Nearer, Place
from nets.reconstruct.fibres.bench.noise_steps import NoiseSteps
from nets.reconstruct.fibres.image.image_fit import ImageFit
from nets.reconstruct.fibres.image.lines_view import LinesView
from nets.reconstruct.fibres.options import FibresOptions
from tests.nets.reconstruct.fibres.test_bench_fits import NUMBERS, bench_with, photographed, run_with
from tests.nets.reconstruct.fibres.three_lines import LINES, SCENE, error_um
from warp_caustics.found_bench.bench_model import STEP
from warp_caustics.found_bench.thin_relief import ThinRelief
from warp_caustics.prints.model import LineModel
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.result import Resimulation
from warp_caustics.reconstruct.seen_camera.point_spread import PointSpread, fine_pixels

FARTHER = dict(gap_m=1.5e-4, tilt_x_rad=1.5e-3, ambient=0.01)


@pytest.fixture(autouse=True)
def effort_of_a_gpu(monkeypatch):
    """Wherever tests run; that of a CPU is in test_noise_steps_on_a_cpu.py."""
    monkeypatch.setitem(noise_steps.EFFORTS, "cpu", noise_steps.EFFORTS["cuda"])


@pytest.fixture
def model():
    return LineModel(SCENE)


def left_as_told(model, true):
    """A run whose lines explain an image of another bench on the told one."""
    told = bench_with()
    scenes = (NUMBERS.scene_of(each.values) for each in (true, told))
    run = run_with(model, photographed(model, true), on_other_bench(LINES, *scenes))
    on = run.on
    run.on, run.note, run.told_share = lambda bench, camera=None: on(bench), lambda loss: None, None
    run.lines, _ = run.together(["ambient"]).on(run.lines, told)
    return run


def way_of_light(bench):
    return ThinRelief.of(NUMBERS.scene_of(bench.values)).linear


def test_a_bench_that_was_left_as_told_is_found(model):
    """Heights make up for it, and 100 pixels that err together do not tell it."""
    true = bench_with(**FARTHER)
    run = left_as_told(model, true)
    assert run.view.is_settled(run.lines) and error_um(model, run.lines) > 8
    told = fit_by_noise(run)
    assert told.asked > 5 * told.least and told.gained > 5 * told.least and told.steps > 1
    assert error_um(model, run.lines) < 0.4
    assert way_of_light(run.bench) / way_of_light(true) == pytest.approx(1, abs=2e-3)
    assert run.bench.values["ambient"] == pytest.approx(0.01, abs=1e-3)
    assert set(run.asked) == set(NUMBERS.names) == set(run.bench.sigma)
    assert run.covariance is not None and run.counted is run.lines
    assert run.view.is_settled(run.lines)


def test_lines_that_leave_no_more_than_noise_stay_where_they_are(model):
    run = run_with(model, photographed(model, bench_with()), LINES.clone())
    run.note, run.told_share = lambda loss: None, None
    kept = run.lines, run.bench, run.view
    told = fit_by_noise(run)
    assert told.asked < told.least and told.steps == 0 and told.gained == 0
    assert (run.lines, run.bench, run.view) == kept and run.covariance is None


def test_less_than_simulations_are_wrong_by_is_no_reason(model, monkeypatch):
    run = left_as_told(model, bench_with(**FARTHER))
    lines, bench, shape = run.lines, run.bench, model.shape
    monkeypatch.setattr(noise_steps, "SURE", 1e4)
    told = fit_by_noise(run)
    assert told.asked < told.least and run.lines is lines and run.bench is bench and model.shape == shape


def test_steps_that_no_longer_explain_the_image_are_taken_back(model, monkeypatch):
    run, answers = left_as_told(model, bench_with(**FARTHER)), [True, False]
    lines, bench, view, shape = run.lines, run.bench, run.view, model.shape
    monkeypatch.setattr(LinesView, "is_settled", lambda self, lines: answers.pop(0))
    assert fit_by_noise(run).is_more and not answers
    assert run.lines is lines and run.bench is bench and run.view is view and model.shape == shape
    assert run.covariance is None and run.hinted == 0.0


def test_lines_that_leave_more_than_noise_are_not_asked(model, monkeypatch):
    run = left_as_told(model, bench_with(**FARTHER))
    monkeypatch.setattr(LinesView, "is_settled", lambda self, lines: False)
    assert fit_by_noise(run) is None


@pytest.mark.parametrize(
    ("told_share", "is_found", "expected"),
    [
        ((0.005, 0.003), False, False),
        ((-0.007, 0.003), False, True),
        ((0.002, 0.003), True, False),
        ((-0.004, 0.003), True, True),
        (None, False, True),
        (None, True, True),
    ],
)
def test_a_bench_that_is_as_it_was_told_or_found_is_not_asked_again(model, told_share, is_found, expected):
    run = left_as_told(model, bench_with())
    run.told_share = told_share
    run.covariance = object() if is_found else None
    assert is_open(run) == expected
    if not expected:
        assert fit_by_noise(run) is None


def test_a_bench_that_lines_hardly_tell_is_asked_where_its_noise_does(model):
    """By what all lines hint at together, in fewer pictures than lines have numbers."""
    run, true = left_as_told(model, bench_with(**FARTHER)), bench_with(**FARTHER)
    run.told_share = (0.005, 0.003)
    assert not is_open(run)
    told = fit_by_noise(run)
    assert told.is_more and error_um(model, run.lines) < 0.4
    assert way_of_light(run.bench) / way_of_light(true) == pytest.approx(1, abs=2e-3)


@pytest.mark.parametrize(("apart", "expected"), [({}, False), (dict(gap_m=2e-5), True), (FARTHER, True)])
def test_a_bench_hints_that_it_is_another(model, apart, expected):
    """Not one as told, whose pictures are simulated wrong by as much."""
    run = left_as_told(model, bench_with(**apart))
    steps = NoiseSteps(run)
    lines, bench, shape = run.lines, run.bench, model.shape
    assert steps.is_hinted() == expected
    assert run.lines is lines and run.bench is bench and model.shape == shape
    assert steps.told == noise_steps.Told()


def test_lines_alike_promise_less_than_lines_apart(model):
    """They are some of the ways in which lines may move."""
    run = left_as_told(model, bench_with(**FARTHER))
    steps, here = NoiseSteps(run), Place(run.lines, model.shape, run.bench, run.view.camera)
    picture = steps._at(here)
    steps._ask_noise(picture, here.bench)
    alike, apart = (
        steps._asked(linear) for linear in (steps._linear_alike(here, picture), linear_at(steps, here, picture))
    )
    assert 0.1 * apart < alike < apart


def test_what_is_interrupted_is_as_it_was(model):
    run = left_as_told(model, bench_with(**FARTHER))
    lines, bench, shape = run.lines, run.bench, model.shape

    def over(loss):
        raise KeyboardInterrupt

    run.note = over
    with pytest.raises(KeyboardInterrupt):
        fit_by_noise(run)
    assert run.lines is lines and run.bench is bench and model.shape == shape


def test_an_image_whose_noise_nobody_knows_has_none(model, monkeypatch):
    run = left_as_told(model, bench_with())
    whole = dataclasses.replace(run.view.discrepancy.whole, noise=None)
    monkeypatch.setattr(run.view.discrepancy, "whole", whole)
    with pytest.raises(ValueError, match="need that noise"):
        NoiseSteps(run)


def test_the_picture_is_linear_about_a_place(model):
    """Information and gradient by pictures themselves: what a small step changes is what they say, to 2 %."""
    run = left_as_told(model, bench_with(**FARTHER))
    steps = NoiseSteps(run)
    here = Place(run.lines, model.shape, run.bench, run.view.camera)
    picture = steps._at(here)
    steps._ask_noise(picture, here.bench)
    linear = linear_at(steps, here, picture)
    nearer = steps._nearer(here, linear, picture)
    torch.testing.assert_close(nearer.picture, steps._at(nearer.place))
    assert nearer.gain == pytest.approx(linear.gain(linear.step()), rel=0.3)
    rng, size = np.random.default_rng(0), len(linear.at)
    field = np.zeros(len(linear.gradient))
    field[size + len(NUMBERS.names) :] = 0.02 * rng.standard_normal(len(field) - size - len(NUMBERS.names))
    bench = here.bench.moved(NUMBERS, field[size:] * steps._widths)
    moved = Place(here.lines, here.shape, bench, here.camera)
    left = steps._misfit.left
    change = left(steps._at(moved)) + float(np.square(steps._believed(bench)).sum()) - left(picture)
    expected = 2 * linear.gradient @ field + field @ linear.information @ field
    assert change == pytest.approx(expected, rel=0.1)


def test_noise_by_what_was_measured_makes_light_too_dark(model):
    """Where neighbours share it: pixels too bright by chance count less. By what is shown they do not."""
    rng, told = np.random.default_rng(4), bench_with()
    white = rng.standard_normal((3, 128, 128))
    speckle = torch.nn.functional.avg_pool2d(torch.from_numpy(white)[None], 3, 1, 1)[0].numpy()
    image = photographed(model, told)
    rough = image.irradiance * (1 + 0.04 * speckle / speckle.std())
    image = CausticImage(rough.astype(np.float32), image.noise_std)
    run = run_with(model, image, LINES.clone())
    run.note = lambda loss: None
    grain = torch.full((3, 1, 1), 0.04, dtype=torch.float64)
    found = []
    for by_measured in (False, True):
        steps = NoiseSteps(run)
        misfit = steps._misfit
        misfit._noise_of = misfit._noise_of._replace(grain=grain)
        place = Place(run.lines, model.shape, run.bench, run.view.camera)
        picture = steps._at(place)
        steps._ask_noise(picture, run.bench)
        if by_measured:
            misfit._noise = misfit._noise_of(misfit.measured)
        linear = linear_at(steps, place, picture)
        first = len(linear.at) + len(NUMBERS.names)
        found.append(0.05 * linear.step(first)[first : first + 3].mean())
    right, wrong = found
    assert abs(right) < 2e-3 and wrong < -5e-3


@pytest.mark.parametrize("memory", ["enough", "little"])
def test_a_result_says_what_steps_were_told(monkeypatch, memory):
    def steps(run):
        if memory == "little":
            raise torch.cuda.OutOfMemoryError("of a small GPU")
        return noise_steps.Told(asked=5.0, least=20.0)

    monkeypatch.setattr(lines_of_image, "fit_by_noise", steps)
    monkeypatch.setattr(torch.cuda, "empty_cache", lambda: None)
    method = SimpleNamespace(
        options=FibresOptions(last_steps=True), device=torch.device("cpu"), takes_bench_as_told=False
    )
    run = SimpleNamespace(method=method, counters={})
    lines_of_image.LinesOfImage._fit_by_noise(run)
    told = run.counters["last_steps"]
    assert told == {"asked": 5.0, "least": 20.0, "gained": 0.0, "steps": 0} if memory == "enough" else "memory" in told
    method.takes_bench_as_told, run.counters = True, {}
    lines_of_image.LinesOfImage._fit_by_noise(run)
    assert not run.counters


def test_pictures_that_are_compared_are_nearer_to_finer_ones(model):
    """And coarser ones tell no less than they are off by."""
    run = left_as_told(model, bench_with())
    camera, steps = behind_lens(run.view.camera), NoiseSteps(run)
    place = Place(run.lines, model.shape, run.bench, camera)
    compared, heights = steps._at(place), model.heights(run.lines)
    usual, coarser, exact = (steps.shown(heights, run.bench, camera, finer) for finer in (1, steps._finer - 1, 8))
    off = [float((each - exact).norm()) for each in (usual, compared)]
    assert off[1] < 0.3 * off[0]
    assert off[1] < float((coarser - compared).norm()) < off[0]


@pytest.mark.parametrize(("name", "share"), [("screen_x_m", 0.3), ("tilt_x_rad", 0.3), ("gap_m", 1.05)])
def test_large_differences_fold_back_less(model, monkeypatch, name, share):
    """Of what lies aside half of a derivative is that by light that moves within a fine pixel; wide lines hide it of a
    gap.
    """
    run = left_as_told(model, bench_with())
    place = Place(run.lines, model.shape, run.bench, behind_lens(run.view.camera))
    steps, heights = NoiseSteps(run), model.heights(run.lines)
    folded = []
    for differences in (noise_bench.BENCH_STEP, STEP):
        monkeypatch.setattr(noise_bench, "BENCH_STEP", differences)
        usual, fine = (by_number(steps, place, heights, name, finer) for finer in (1, 4))
        folded.append(float((usual - fine).norm() / fine.norm()))
    assert 0 < folded[0] < share * folded[1]


def by_number(steps, place, heights, name, finer):
    """Derivative of what is shown by a number of the bench, on so many times as many fine pixels."""
    fine = SimpleNamespace(**{**vars(steps), "numbers": NUMBERS.only([name])})
    fine.shown = lambda heights, bench, camera, **_: steps.shown(heights, bench, camera, finer)
    fine._picture = lambda bench, camera, **_: steps._picture(bench, camera, finer)
    # Only derivatives by stray light and the like need what is shown there.
    return next(NoiseSteps._by_all(fine, place, heights, heights.new_zeros(0, *heights.shape), picture=None))


def test_a_lens_is_moved_as_derivatives_say(model):
    """In light that is uneven and stray, as what was measured is compared."""
    run = left_as_told(model, bench_with())
    bench = dataclasses.replace(bench_with(ambient=0.02), field=np.linspace(-0.05, 0.05, len(run.bench.field)))
    camera, steps, heights = behind_lens(run.view.camera), NoiseSteps(run), model.heights(run.lines)
    place = Place(run.lines, model.shape, bench, camera)
    factor = ShownLight.by(NUMBERS, bench, steps.device).factor
    rows = torch.stack(list(steps._by_lens(place, heights, factor)))
    step = 0.02 * np.random.default_rng(0).standard_normal(lens_numbers.count_of(camera))
    low, high = (steps.shown(heights, bench, lens_numbers.moved(camera, side * step / 2)) for side in (-1, 1))
    expected = torch.einsum("k,kcij->cij", torch.from_numpy(step), rows)
    assert float((high - low - expected).norm()) < 0.01 * float(expected.norm())


def test_steps_go_on_below_what_they_must_gain_in_all(model, monkeypatch):
    """That decides whether there are any; a single one need not gain as much."""
    steps = NoiseSteps(left_as_told(model, bench_with()))
    rounds = by_gains(monkeypatch, [[60.0, 10.0, 0.2], [2.0, None], [0.5, None]], promised=1.0)
    steps()
    assert steps.told == noise_steps.Told(asked=70.0, least=50.0, gained=72.7, steps=5)
    assert len(rounds) == 3 and not any(rounds)


@pytest.mark.parametrize(
    ("gains", "promised", "used"), [([5.0] * 9, 1.0, 5), ([5.0] * 9, 0.2, 1), ([5.0, 4.0, 0.1, 9.0], 1.0, 3)]
)
def test_steps_by_the_same_derivatives_end_where_they_gain_or_promise_little(model, monkeypatch, gains, promised, used):
    steps = NoiseSteps(left_as_told(model, bench_with()))
    steps.effort = steps.effort._replace(rounds=1)
    (rest,) = by_gains(monkeypatch, [list(gains)], promised)
    steps()
    assert steps.told.steps == used and len(rest) == len(gains) - used
    assert steps.told.gained == pytest.approx(sum(gains[:used]))


def by_gains(monkeypatch, rounds, promised):
    """Steps that gain so much, one round after the other, None where no place leaves less; what is left of them."""
    begun, linear = iter(rounds), SimpleNamespace(gain=lambda step: promised, step=lambda: None)
    now = []

    def slopes(self, here, picture):
        now[:] = [next(begun)]

    def nearer(self, here, linear, picture, parts):
        gain = now[0].pop(0)
        return gain and Nearer(here, picture, gain)

    monkeypatch.setattr(NoiseSteps, "_slopes", slopes)
    monkeypatch.setattr(NoiseSteps, "_about", lambda self, here, picture, ways, slopes: linear)
    monkeypatch.setattr(NoiseSteps, "_asked", lambda self, linear: 70.0)
    monkeypatch.setattr(NoiseSteps, "_least", lambda self, here, picture: 50.0)
    monkeypatch.setattr(NoiseSteps, "_nearer", nearer)
    return rounds


def test_the_same_derivatives_lead_to_where_new_ones_do(model, monkeypatch):
    """Along the valley what is left bends more than they do: in a picture each in place of two for every number."""
    true, found = bench_with(**FARTHER), {}
    for chords in (0, 4):
        run = left_as_told(model, true)
        monkeypatch.setattr(noise_steps, "CHORDS", chords)
        steps = NoiseSteps(run)
        steps.effort = steps.effort._replace(rounds=1)
        place = steps()
        found[chords] = steps.told, abs(way_of_light(place.bench) / way_of_light(true) - 1)
    assert found[4][0].steps > 1 == found[0][0].steps
    assert found[4][0].gained > found[0][0].gained + 1
    assert found[4][1] < 0.5 * found[0][1]


def linear_at(steps, here, picture):
    return steps._about(here, picture, steps._ways(here), steps._slopes(here, picture))


def behind_lens(camera):
    """The camera with a lens of half a pixel that is known."""
    return dataclasses.replace(camera, spread=PointSpread.of_lens(np.full(3, 0.5)), pixels=128)


@pytest.mark.parametrize(("pixels", "finer"), [(128, 3), (512, 3), (1024, 2), (2048, 2)])
def test_fine_pixels_are_no_more_than_a_computer_holds(model, monkeypatch, pixels, finer):
    run = left_as_told(model, bench_with())
    monkeypatch.setattr(noise_steps, "fine_pixels", lambda own: fine_pixels(pixels))
    assert NoiseSteps(run)._finer == finer


def test_people_are_told_of_the_misfit_of_fits(model):
    """In the units of descents, so that a report's curve goes on."""
    run, told = left_as_told(model, bench_with(**FARTHER)), []
    run.note = told.append
    loss = ImageFit(SCENE, run.view.image, model, SCENE.image_pixels).loss(model.heights(run.lines))
    fit_by_noise(run)
    assert len(told) > 8 and told[0] == pytest.approx(loss, rel=0.2) and told[-1] <= told[0]


def test_views_are_those_of_resimulations(model):
    """What a run's picture shows is what its view compares with the image."""
    run = left_as_told(model, bench_with())
    assert isinstance(run.view.resimulation, Resimulation)
    steps = NoiseSteps(run)
    shown = steps.shown(model.heights(run.lines), run.bench, run.view.camera)
    seen = run.view.discrepancy.picture(run.view.relief(run.lines))
    torch.testing.assert_close(shown.float(), seen, atol=1e-4, rtol=1e-3)
