"""The camera that lines tell."""

import dataclasses

import numpy as np
import pytest
import torch

from nets.reconstruct.fibres.bench.bench_and_light import Bench, seen_on
from nets.reconstruct.fibres.bench.bench_of_lines import BenchOfLines, numbers_of_lines
from nets.reconstruct.fibres.bench.camera_of_lines import (
    fit_on_told,
    fit_through_blurring_lens,
    fit_through_lens,
    with_spread_of,
)
from nets.reconstruct.fibres.image.lines_view import LinesView
from tests.nets.reconstruct.cameras import blurring, through_lens
from tests.nets.reconstruct.exact_light import light_of
from tests.nets.reconstruct.fibres.line_run import line_run
from tests.nets.reconstruct.fibres.three_lines import LINES, SCENE, error_um
from warp_caustics.found_bench.bench_numbers import BenchNumbers
from warp_caustics.prints.model import LineModel
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.result import Resimulation
from warp_caustics.resampling import blur_matrices, blurred
from warp_caustics.setup.optical import with_optical_values
from warp_caustics.simulator import CausticSimulator

BLUR, NOISE = 0.8, 0.005


@pytest.fixture(scope="module")
def model():
    return LineModel(SCENE)


@pytest.fixture(scope="module")
def image(model):
    pixels = SCENE.image_pixels
    many = light_of(SCENE, model.heights(LINES))
    shown = blurred(many, blur_matrices(pixels, np.full(3, BLUR), "cpu")).numpy()
    noise = NOISE * np.random.default_rng(0).standard_normal(shown.shape)
    return CausticImage((shown + noise).astype(np.float32), np.full(3, NOISE))


def run_with(model, image, lines, blur_px):
    plain = Resimulation(CausticSimulator(SCENE), image)
    view = LinesView(plain.through(blurring(blur_px, SCENE.image_pixels)), model)
    numbers = numbers_of_lines(BenchNumbers.of(SCENE))

    def on(bench, camera=None):
        if camera is None:
            found = plain.found_camera(view.relief(run.lines), exactly=True)
            camera = with_spread_of(found, run.view.camera)
        simulator = CausticSimulator(numbers.scene_of(bench.values))
        return LinesView(Resimulation(simulator, seen_on(image, numbers, bench)).through(camera), model)

    def together():
        return BenchOfLines(numbers, image, model, SCENE.image_pixels // 2, run.view.camera)

    run = line_run(
        model=model, lines=lines, view=view, bench=Bench.told(numbers), numbers=numbers, on=on, together=together
    )
    run.note, run.search = lambda loss: None, lambda lines, jumps: None
    return run


def test_lines_that_are_right_tell_the_blur(model, image):
    """To a hundredth of a pixel, with lines 20 um off, which the wrong blur had bent."""
    run = run_with(model, image, LINES + 2e-5, 0.5)
    fit_through_lens(run)
    np.testing.assert_allclose(run.view.camera.blur, BLUR, atol=0.02)
    assert error_um(model, run.lines) < 0.3 * error_um(model, LINES + 2e-5)


def test_a_camera_that_is_right_stays(model, image):
    run = run_with(model, image, LINES, 0.5)
    fit_through_lens(run)
    lines, view = run.lines, run.view
    fit_through_lens(run)
    assert run.lines is lines and run.view is view


def test_an_interrupted_fit_changes_nothing(model, image):
    run = run_with(model, image, LINES + 2e-5, 0.5)
    lines, view = run.lines, run.view

    def stop(loss):
        raise KeyboardInterrupt

    run.note = stop
    with pytest.raises(KeyboardInterrupt):
        fit_through_lens(run)
    assert run.lines is lines and run.view is view


def photographed(model, scene):
    return through_lens(scene, model.heights(LINES), 0.5, NOISE)


@pytest.fixture(scope="module")
def lens_image(model):
    return photographed(model, SCENE)


def test_a_lens_before_the_pixels_is_found(model, lens_image):
    """With lines 20 um off; a Gaussian in the pixels' band leaves three times the noise, and lines further off."""
    run = run_with(model, lens_image, LINES + 2e-5, 0.5)
    usual = run.view.left(LINES)
    fit_through_lens(run)
    np.testing.assert_allclose(run.view.camera.spread.lens_px, 0.5, atol=0.03)
    assert run.view.left(run.lines) < 0.5 * usual
    assert run.view.is_explained(run.lines)
    assert error_um(model, run.lines) < 0.3 * error_um(model, LINES + 2e-5)


def test_a_camera_that_is_sharp_is_not_asked(model):
    """Where lines leave nothing but noise."""
    shown = light_of(SCENE, model.heights(LINES)).numpy()
    noise = NOISE * np.random.default_rng(0).standard_normal(shown.shape)
    run = run_with(model, CausticImage((shown + noise).astype(np.float32), np.full(3, NOISE)), LINES, 0.0)
    fit_through_lens(run)
    assert run.view.camera.is_perfect


def test_lines_that_leave_more_than_noise_tell_no_lens(model):
    """One is missing: a camera that sharpens would leave less, and all lines further off."""
    more = torch.cat([LINES, 1e-3 * torch.tensor([[2.0, -17.0, 6.0, 15.0, 3.6, 0.6]], dtype=torch.float64)])
    shown = light_of(SCENE, model.heights(more)).numpy()
    noise = NOISE * np.random.default_rng(0).standard_normal(shown.shape)
    run = run_with(model, CausticImage((shown + noise).astype(np.float32), np.full(3, NOISE)), LINES, 0.5)
    fit_through_lens(run)
    fit_through_blurring_lens(run)
    assert not run.view.is_explained(run.lines)
    assert run.view.camera.spread is None


def test_a_lens_is_asked_where_a_gaussian_passes_for_it(model):
    """In more noise, of which a Gaussian leaves a tenth more; an explained image asks for no lens that leaves as much."""
    image = through_lens(SCENE, model.heights(LINES), 0.5, 4 * NOISE)
    run = run_with(model, image, LINES, 0.5)
    assert run.view.is_explained(run.lines)
    was = run.view.left(run.lines)
    fit_through_blurring_lens(run)
    assert run.view.left(run.lines) < 0.95 * was
    np.testing.assert_allclose(run.view.camera.spread.lens_px, 0.5, atol=0.05)
    view, lines = run.view, run.lines
    fit_through_blurring_lens(run)
    assert run.view is view and run.lines is lines


def test_a_bench_that_was_found_for_want_of_the_lens_is_left(model, lens_image):
    run = run_with(model, lens_image, LINES, 0.5)
    told, wrong = run.bench, dict(run.bench.values) | {"ambient": 0.01}
    run.bench, run.is_elsewhere = dataclasses.replace(told, values=wrong), True
    run.view = run.on(run.bench, run.view.camera)
    fit_through_lens(run)
    fit_on_told(run)
    assert run.bench.values == told.values
    assert not run.is_elsewhere
    assert run.view.is_explained(run.lines)


def test_a_bench_that_is_another_stays(model):
    """A gap of 0.3 mm more: lines leave more of the image where it is not."""
    there = {"gap_m": 3e-4}
    run = run_with(model, photographed(model, with_optical_values(SCENE, there)), LINES, 0.5)
    bench = run.bench = dataclasses.replace(run.bench, values=dict(run.bench.values) | there)
    run.is_elsewhere = True
    run.view = run.on(run.bench, run.view.camera)
    fit_through_lens(run)
    lines, view = run.lines, run.view
    assert view.camera.spread is not None
    fit_on_told(run)
    assert run.is_elsewhere and run.bench is bench
    assert run.lines is lines and run.view is view
