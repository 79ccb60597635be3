"""The bench that lines tell, on a small scene."""

import dataclasses
import math

import numpy as np
import pytest
import torch

from nets.reconstruct.fibres.bench.bench_and_light import Bench, ShownLight, field_modes, lit, seen_on, stretched
from nets.reconstruct.fibres.bench.bench_of_lines import BenchOfLines, numbers_of_lines
from nets.reconstruct.fibres.bench.line_posterior import (
    JointCovariance,
    drawn_lines,
    height_deviation,
    joint_covariance,
    misfit_weight,
)
from nets.reconstruct.fibres.image.descent import Beside
from nets.reconstruct.fibres.image.image_fit import ImageFit
from nets.reconstruct.fibres.image.lines_view import LinesView
from nets.reconstruct.fibres.trust.beliefs import times_less_known
from nets.reconstruct.fibres.trust.stated_bench import stated_bench, stated_record
from tests.nets.reconstruct.cameras import blurring
from tests.nets.reconstruct.exact_light import light_of
from warp_caustics.found_bench.bench_numbers import BenchNumbers
from warp_caustics.found_bench.bench_uncertainty import GAP_M
from warp_caustics.prints.model import LineModel
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.result import Resimulation
from warp_caustics.reconstruct.seen_camera.point_spread import PointSpread
from warp_caustics.resampling import blur_matrices, blurred
from warp_caustics.scene import Scene
from warp_caustics.setup.optical import with_optical_values
from warp_caustics.simulator import CausticSimulator

N = 48
SCENE = Scene(height_samples=N, image_pixels=4 * N, screen_position_m=(0.0, 0.0, -1e-3))
MODEL = LineModel(SCENE)
LINES = 1e-3 * torch.tensor(
    [
        [-15.0, -12.0, 14.0, 9.0, 4.0, 0.9],
        [-9.0, 15.0, 10.0, -16.0, 3.2, 1.2],
        [-18.0, 5.0, 12.0, 16.0, 3.6, 1.0],
    ],
    dtype=torch.float64,
)
OFF = 1e-3 * torch.tensor([0.05, -0.05, -0.05, 0.05, 0.1, -0.03], dtype=torch.float64)
NOISE = 0.005
BLUR = np.full(3, 0.8)
CAMERA = blurring(BLUR, SCENE.image_pixels)


def numbers():
    return numbers_of_lines(BenchNumbers.of(SCENE))


def true_bench(**values):
    told = Bench.told(numbers())
    field = np.zeros(len(told.field))
    field[3] = 0.02
    return Bench({**told.values, **values}, field)


def photographed(bench):
    """Lines on a bench through a soft lens, with noise."""
    scene = with_optical_values(SCENE, {k: v for k, v in bench.values.items() if k != "ambient"})
    shown = blurred(light_of(scene, MODEL.heights(LINES)), blur_matrices(4 * N, BLUR, "cpu")).numpy()
    measured = lit(shown.astype(np.float64), numbers(), bench, np.ones(3))
    noise = NOISE * np.random.default_rng(0).standard_normal(shown.shape)
    return CausticImage((measured + noise).astype(np.float32), np.full(3, NOISE))


def error_um(lines):
    return 1e6 * float((MODEL.heights(lines) - MODEL.heights(LINES)).square().mean().sqrt())


def test_lines_tell_the_gap_that_free_heights_make_up_for():
    image = photographed(true_bench(gap_m=1.1e-3, ambient=0.02, screen_x_m=4e-5))
    told = ImageFit(SCENE, image, MODEL, 4 * N, camera=CAMERA)
    wrong = told.descend(LINES + OFF, 40).lines
    asked = numbers().only([name for name in numbers().names if not name.startswith("tilt")])
    together = BenchOfLines(asked, image, MODEL, 2 * N, CAMERA)
    lines, bench = together(wrong, Bench.told(numbers()))
    assert error_um(wrong) > 5
    assert error_um(lines) < 1.5
    assert bench.values["ambient"] == pytest.approx(0.02, abs=0.004)
    assert bench.values["screen_x_m"] == pytest.approx(4e-5, abs=3e-6)
    assert bench.field[3] == pytest.approx(0.02, abs=0.004)
    # Gap, base and index hang together: how far light goes behind the crown is told.
    throw = bench.values["gap_m"] + (bench.values["base_thickness_m"] - 3e-3) / 1.46
    assert throw == pytest.approx(1.1e-3, abs=4e-5)
    assert all(0 < bench.sigma[p.name] <= 1.01 * p.prior for p in asked.parameters)
    assert bench.values["tilt_x_rad"] == 0.0 and "tilt_x_rad" not in bench.sigma


def test_a_gap_that_was_asked_alone_is_as_uncertain_as_base_and_index_leave_it():
    """A base that is thicker than told is found as a gap, as if known to 4 um; what is stated covers that none is there."""
    image = photographed(true_bench(base_thickness_m=3.1e-3))
    alone = BenchOfLines(numbers().only(["gap_m"]), image, MODEL, 2 * N, CAMERA)
    lines, bench = alone(LINES, Bench.told(numbers()))
    bench = alone.with_sigma(bench, alone.covariance(lines, bench))
    simulator = CausticSimulator(numbers().scene_of(bench.values), "lattice")
    view = LinesView(Resimulation(simulator, seen_on(image, numbers(), bench)).through(CAMERA), MODEL)
    told = numbers().before["gap_m"]

    def stated(**widths):
        known = numbers_of_lines(BenchNumbers.of(SCENE, widths))
        return stated_bench(BenchOfLines(known, image, MODEL, 2 * N, CAMERA), lines, view, bench)

    off = bench.values["gap_m"] - told
    assert off == pytest.approx(0.1e-3 / 1.46, rel=0.2), "as far as light goes in so much glass"
    found = stated()
    assert bench.sigma["gap_m"] < off / 8
    assert off / 4 < found.sigma["gap_m"] < off
    assert found.sigma.keys() == bench.sigma.keys() and found.values == bench.values
    exact = stated(base_thickness_m=0.0, index_offset=0.0)
    assert exact.sigma["gap_m"] < 0.5 * found.sigma["gap_m"]
    record = {number.name: number for number in stated_record(numbers(), found).numbers}
    assert record["gap_m"].found == bench.values["gap_m"] and record["gap_m"].verdict == "as told"
    assert record["gap_m"].prior == pytest.approx(times_less_known(numbers(), bench) * GAP_M)


def test_stray_light_is_as_uncertain_as_halos_of_a_lens_leave_it():
    """Of no other number more is left open."""
    image = photographed(true_bench(ambient=0.02))
    together, bench = BenchOfLines(numbers(), image, MODEL, 2 * N, CAMERA), true_bench(ambient=0.02)
    bench = together.with_sigma(bench, together.covariance(LINES, bench))
    here = Resimulation(CausticSimulator(numbers().scene_of(bench.values), "lattice"), seen_on(image, numbers(), bench))
    plain, found = {}, {}
    for sigma, stray in ((plain, 0.0), (found, 0.003)):
        spread = dataclasses.replace(PointSpread.of_lens(np.full(3, 0.5)), stray=stray)
        seen = here.through(dataclasses.replace(CAMERA, spread=spread))
        sigma |= stated_bench(together, LINES, LinesView(seen, MODEL), bench).sigma
    assert found.pop("ambient") == pytest.approx(math.hypot(0.003, plain.pop("ambient")))
    assert found == plain


def test_stray_light_in_an_image_that_is_mostly_noise_is_not_taken_for_less():
    """Without it an image is brighter, noise and all: what is left must not seem less where less is taken off."""
    shown = blurred(light_of(SCENE, MODEL.heights(LINES)), blur_matrices(4 * N, BLUR, "cpu")).numpy()
    noise = 0.05 * np.random.default_rng(3).standard_normal(shown.shape)
    image = CausticImage(((shown + 0.1) / 1.1 + noise).astype(np.float32), np.full(3, 0.05))
    told = Bench.told(numbers())
    start = dataclasses.replace(told, values={**told.values, "ambient": 0.097})
    _, bench = BenchOfLines(numbers().only(["ambient"]), image, MODEL, 2 * N, CAMERA)(LINES, start)
    assert bench.values["ambient"] == pytest.approx(0.1, abs=0.005)


def test_noise_is_stretched_as_an_image_is():
    bench = Bench({**Bench.told(numbers()).values, "ambient": 0.1}, np.array([0.05, -0.05, 0.0, 0.1, 0, 0, 0, 0]))
    noise = np.random.default_rng(2).standard_normal((3, 4 * N, 4 * N))
    image = CausticImage((1 + NOISE * noise).astype(np.float32), np.full(3, NOISE))
    seen = seen_on(image, numbers(), bench)
    light = bench.light(4 * N)
    left = seen.irradiance - (1.1 / light - 0.1)
    np.testing.assert_allclose(seen.noise_std, left.std(axis=(1, 2)), rtol=0.01)
    np.testing.assert_allclose(stretched(numbers(), bench), seen.noise_std / NOISE)


def test_a_bench_that_is_as_told_is_left_so():
    image = photographed(Bench.told(numbers()))
    _, bench = BenchOfLines(numbers(), image, MODEL, 2 * N, CAMERA)(LINES, Bench.told(numbers()))
    for p in numbers().parameters:
        assert abs(bench.values[p.name] - numbers().before[p.name]) < 0.6 * p.prior
    assert np.abs(bench.field).max() < 0.005


def test_numbers_that_are_known_exactly_stay():
    known = numbers_of_lines(BenchNumbers.of(SCENE, {"gap_m": 0.0, "vergence_per_m": 0.0}))
    assert not {"gap_m", "vergence_per_m"} & set(known.names)
    assert {"base_thickness_m", "index_offset"} <= set(known.names)


@pytest.mark.parametrize("values", [{"ambient": 0.05}, {"vergence_per_m": 2.0, "ambient": 0.01}])
def test_an_image_is_taken_to_another_bench_and_back(values):
    bench, exposure = true_bench(**values), np.array([0.9, 1.0, 1.1])
    shown = np.random.default_rng(1).uniform(0.2, 3.0, (3, 4 * N, 4 * N))
    image = CausticImage(lit(shown, numbers(), bench, exposure), np.full(3, NOISE))
    np.testing.assert_allclose(seen_on(image, numbers(), bench, exposure).irradiance, shown, rtol=1e-9, atol=1e-9)


def test_pixels_that_the_border_of_a_found_picture_crosses_do_not_count():
    """Where the picture lies aside by 0.4 px its last pixels are half dark, or were divided by what is."""
    image = CausticImage(np.ones((3, 4 * N, 4 * N)), np.full(3, NOISE))
    aside = Bench({**true_bench().values, "screen_x_m": 0.4 * SCENE.pixel_size_m[0]}, np.zeros(8))
    counted = seen_on(image, numbers(), aside).mask
    expected = np.ones((3, 4 * N, 4 * N), bool)
    expected[:, :, -1] = False
    np.testing.assert_array_equal(counted, expected)
    dead = np.ones(expected.shape, bool)
    dead[0, 5, 7] = False
    both = seen_on(dataclasses.replace(image, mask=dead), numbers(), aside).mask
    np.testing.assert_array_equal(both, expected & dead)
    assert seen_on(image, numbers(), Bench.told(numbers())).mask is None


def test_light_as_told_is_not_computed_again():
    """A gap alone leaves the image as it was measured, in its own array; stray light does not."""
    image = CausticImage(np.ones((3, 4 * N, 4 * N), np.float32), noise_std=np.full(3, 0.01))
    told = Bench.told(numbers())
    gap = dataclasses.replace(told, values={**told.values, "gap_m": 1e-4})
    assert seen_on(image, numbers(), gap).irradiance is image.irradiance
    assert (stretched(numbers(), gap) == 1).all() and stretched(numbers(), gap).shape == (3,)
    stray = dataclasses.replace(told, values={**told.values, "ambient": 0.01})
    seen = seen_on(image, numbers(), stray)
    level = np.asarray(numbers().scene.radiosity_W_m2)[:, None, None]
    np.testing.assert_allclose(seen.irradiance, 1.01 - 0.01 * np.broadcast_to(level, (3, 4 * N, 4 * N)))
    np.testing.assert_allclose(seen.noise_std, 0.0101)


def test_patterns_of_light_are_even_on_average_but_for_brightness():
    modes = field_modes(3, 64)
    assert modes.shape == (8, 3, 64, 64)
    np.testing.assert_allclose(modes[3:].mean(axis=(2, 3)), 0.0, atol=2e-4)
    np.testing.assert_array_equal(modes[:3].mean(axis=(2, 3)), np.eye(3))


def test_light_of_a_bench_is_the_sum_of_its_patterns():
    field = np.random.default_rng(0).uniform(-0.1, 0.1, 8)
    for amplitudes in (field, np.append(field[:3], np.zeros(5)), np.zeros(8)):
        bench = dataclasses.replace(Bench.told(numbers()), field=amplitudes)
        expected = 1 + np.tensordot(amplitudes, field_modes(3, 16), 1)
        np.testing.assert_allclose(bench.light(16), expected, rtol=1e-12)


@pytest.mark.parametrize("values", [{}, {"ambient": 0.03}, {"ambient": 0.03, "vergence_per_m": 2.0}])
def test_what_is_shown_by_a_bench_is_lit_by_it(values):
    """Whichever bench was asked for before."""
    shown = np.random.default_rng(1).uniform(0.5, 2.0, (3, 4 * N, 4 * N))
    told = Bench.told(numbers())
    for seed in (0, 1, 0):
        field = np.random.default_rng(seed).uniform(-0.1, 0.1, len(told.field))
        bench = dataclasses.replace(told, values=told.values | values, field=field)
        by = ShownLight.by(numbers(), bench, torch.device("cpu"))
        expected = lit(shown, numbers(), bench, np.ones(3))
        np.testing.assert_allclose(torch.from_numpy(shown) * by.factor + by.added, expected, rtol=1e-12)


def test_gradient_by_what_is_beside():
    """Against differences of the loss."""
    image = photographed(Bench.told(numbers()))
    fit = ImageFit(SCENE, image, MODEL, 2 * N, camera=CAMERA)
    modes = torch.tensor(field_modes(3, 2 * N), dtype=torch.float32)
    beside = Beside(modes, np.linspace(-1, 1, 8), 1e-3)
    heights, at = MODEL.heights(LINES + OFF), np.linspace(0.01, 0.02, 8)
    gradient = fit.with_gradient(heights, beside, at)[2]
    for k in range(8):
        step = np.zeros(8)
        step[k] = 1e-3
        ahead, behind = (fit.with_gradient(heights, beside, at + sign * step)[0] for sign in (1, -1))
        assert gradient[k] == pytest.approx((ahead - behind) / 2e-3, rel=2e-3, abs=1e-6)


def test_the_joint_covariance_covers_lines_and_knows_what_the_bench_leaves_open():
    """Of a bench whose gap is off by what is believed: errors mostly within two deviations, and not far below."""
    image = photographed(true_bench(gap_m=1.05e-3, ambient=0.02, screen_x_m=4e-5))
    together = BenchOfLines(numbers(), image, MODEL, 2 * N, CAMERA)
    lines, bench = together(LINES + OFF, Bench.told(numbers()))
    covariance = together.covariance(lines, bench)
    deviation = height_deviation(MODEL, lines, covariance)
    true = MODEL.heights(LINES)
    error = (MODEL.heights(lines) - true).abs().double().numpy()
    on_lines = true.numpy() > 1e-5
    assert np.mean(error[on_lines] <= 2 * deviation[on_lines]) > 0.75
    assert np.sqrt(np.mean(deviation**2)) < 8 * np.sqrt(np.mean(error**2))
    assert deviation[~(true.numpy() > 0) & (deviation == 0)].size > 0.3 * deviation.size
    # A bench that is known leaves less open: the same lines with no number free.
    fit = together.fit_on(bench)
    known = joint_covariance(fit, lines, None, misfit_weight(fit, fit.loss(MODEL.heights(lines))))
    alone = height_deviation(MODEL, lines, known)
    assert np.sqrt(np.mean(alone**2)) < 0.85 * np.sqrt(np.mean(deviation**2))


def test_heights_deviate_as_lines_that_are_drawn():
    """To first order: the spread of 200 draws is the deviation, to a tenth."""
    rng = np.random.default_rng(0)
    mixing = rng.standard_normal((18, 18)) * 3e-6
    covariance = JointCovariance(mixing @ mixing.T)
    deviation = height_deviation(MODEL, LINES, covariance)
    drawn = torch.stack([MODEL.heights(lines) for lines in drawn_lines(MODEL, LINES, covariance, 200)])
    where = deviation > 3e-6
    np.testing.assert_allclose(np.median(drawn.std(dim=0).numpy()[where] / deviation[where]), 1.0, atol=0.1)
    assert drawn.std(dim=0).numpy()[deviation == 0].max() < 1e-6


def test_a_bench_found_without_lines_is_that_of_an_image_without_told_stray_light():
    """(E + A) / (1 + A) with A = 0.05, of which 0.02 was told and taken off: what is left is of the same E."""
    found = [
        {"name": "ambient", "found": 0.05, "sigma": 0.001},
        {"name": "screen_x_m", "found": 2e-4, "sigma": 5e-6},
        {"name": "tilt_x_rad", "found": 0.0, "sigma": 0.005},
    ]
    bench = Bench.found(numbers(), {"numbers": found}, 0.02)
    light = np.array([0.0, 0.7, 3.0])
    seen = (light + 0.05) / 1.05
    cleared = seen * 1.02 - 0.02
    stray = bench.values["ambient"]
    np.testing.assert_allclose((light + stray) / (1 + stray), cleared, rtol=1e-12)
    assert bench.values["screen_x_m"] == 2e-4 and bench.sigma["screen_x_m"] == 5e-6
    assert set(bench.values) == set(numbers().names) and not bench.field.any()
    assert bench.values["gap_m"] == Bench.told(numbers()).values["gap_m"]


@pytest.mark.parametrize("vergence", [-6.0, 6.0])
def test_lines_are_found_in_a_picture_of_another_size(vergence):
    """By a size that was found without them: lines see the picture as large as the plate, and results go back."""
    is_large = vergence > 0
    clear = dataclasses.replace(BenchNumbers.of(SCENE), is_picture=is_large)
    looked_for = numbers_of_lines(clear, is_smaller=not is_large)
    there = Bench({**Bench.told(looked_for).values, "vergence_per_m": vergence}, np.zeros(SCENE.n_wavelengths + 5))
    shown = blurred(light_of(SCENE, MODEL.heights(LINES)), blur_matrices(4 * N, BLUR, "cpu")).numpy()
    measured = lit(shown.astype(np.float64), looked_for, there, np.ones(3), looked_for.picture_size(there.values))
    assert np.sqrt(np.mean((measured - shown) ** 2)) > 5 * NOISE
    image = CausticImage(measured.astype(np.float32), np.full(3, NOISE))
    back = seen_on(image, looked_for, there).irradiance
    assert np.sqrt(np.mean((back - shown)[:, 4:-4, 4:-4] ** 2)) < NOISE
    as_told, together = (BenchOfLines(each, image, MODEL, 2 * N, CAMERA) for each in (numbers(), looked_for))
    wrong = as_told.fit_on(Bench.told(numbers())).descend(LINES + OFF, 40).lines
    right = together.fit_on(there).descend(LINES + OFF, 40).lines
    lines, bench = together(right, there)
    assert error_um(wrong) > 5 * error_um(lines) and error_um(lines) < 2
    assert bench.values["vergence_per_m"] == pytest.approx(vergence, abs=0.3)


def test_lines_take_no_picture_for_smaller_that_was_not_found_so():
    low = {p.name: p.low for p in numbers_of_lines(BenchNumbers.of(SCENE)).parameters}
    assert low["vergence_per_m"] == 0
    low = {p.name: p.low for p in numbers_of_lines(BenchNumbers.of(SCENE), is_smaller=True).parameters}
    assert low["vergence_per_m"] < 0
