"""A lamp that is seen as large, told from a lens by lines; on a small scene."""

import math

import numpy as np
import pytest
import torch

from nets.reconstruct.fibres.bench.bench_and_light import Bench, seen_on
from nets.reconstruct.fibres.bench.bench_of_lines import BenchOfLines, numbers_of_lines
from nets.reconstruct.fibres.bench.lamp_of_lines import (
    LEAST_LEFT,
    fit_with_lamp,
    half_angle_of,
    least_between,
    with_lamp,
)
from nets.reconstruct.fibres.image.lines_view import LinesView
from tests.nets.reconstruct.exact_light import light_of
from tests.nets.reconstruct.fibres.line_run import line_run
from warp_caustics.found_bench.bench_numbers import BenchNumbers
from warp_caustics.prints.model import LineModel
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.result import Resimulation
from warp_caustics.resampling import blur_matrices, blurred
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator

N, M = 48, 192
SCENE = Scene(height_samples=N, image_pixels=M)
LINES = 1e-3 * torch.tensor(
    [[-15.0, -12.0, 14.0, 9.0, 4.0, 1.0], [-9.0, 15.0, 10.0, -16.0, 3.2, 1.2], [-18.0, 5.0, 12.0, 16.0, 3.6, 0.8]],
    dtype=torch.float64,
)
NOISE = 0.005
HALF_ANGLE = math.radians(4)
"""A third of a pixel here, as 1.4 degrees are on the default bench."""


def photographed(model, half_angle_rad, blur_px=0.0):
    shown = light_of(with_lamp(SCENE, half_angle_rad), model.heights(LINES))
    if blur_px:
        shown = blurred(shown, blur_matrices(M, np.full(3, blur_px), "cpu"))
    noise = NOISE * np.random.default_rng(0).standard_normal(shown.shape)
    return CausticImage((shown.numpy() + noise).astype(np.float32), np.full(3, NOISE))


def run_with(model, image, lines):
    """On the told bench, through the lens that the lines tell."""
    numbers = numbers_of_lines(BenchNumbers.of(SCENE))
    run = line_run(model=model, lines=lines, bench=Bench.told(numbers), numbers=numbers)

    def on(bench, camera=None):
        simulator = CausticSimulator(run.numbers.scene_of(bench.values))
        plain = Resimulation(simulator, seen_on(image, run.numbers, bench), np.ones(3))
        return LinesView(plain.through(camera or plain.found_camera(run.view.relief(run.lines), exactly=True)), model)

    run.view = LinesView(Resimulation(CausticSimulator(SCENE), image, np.ones(3)), model)
    run.on = on
    run.together = lambda: BenchOfLines(run.numbers, image, model, M // 2, run.view.camera)
    run.view = on(run.bench)
    run.lines, _ = run.together().on(lines, run.bench)
    return run


def error_um(model, lines):
    return 1e6 * float((model.heights(lines) - model.heights(LINES)).square().mean().sqrt())


@pytest.fixture
def model():
    return LineModel(SCENE)


def test_a_blur_is_that_of_a_disc():
    angle = half_angle_of(0.2, SCENE)
    radius_m = math.sin(angle) * 3e-3 / SCENE.glass_indices[1]
    assert radius_m / 2 == pytest.approx(0.2 * SCENE.pixel_size_m[0], rel=0.01)
    assert half_angle_of(0.0, SCENE) == 0.0 and with_lamp(SCENE, angle).lamp_half_angle_rad == angle


def test_a_lamp_is_told_from_a_lens(model):
    run = run_with(model, photographed(model, HALF_ANGLE), LINES + 1e-6)
    before, lens = error_um(model, run.lines), run.view
    fit_with_lamp(run)
    assert run.view is not lens and run.view.left(run.lines) < lens.left(run.lines)
    assert run.numbers.scene.lamp_half_angle_rad == pytest.approx(HALF_ANGLE, rel=0.25)
    assert run.view.camera.blur.max() < lens.camera.blur.max() and error_um(model, run.lines) < before


def test_a_lens_stays_a_lens(model):
    run = run_with(model, photographed(model, 0.0, blur_px=0.35), LINES + 1e-6)
    lines, view, numbers = run.lines, run.view, run.numbers
    fit_with_lamp(run)
    assert run.lines is lines and run.view is view and run.numbers is numbers


def test_a_lens_of_tails_stays_a_lens(model):
    """A disc is no Gaussian, and leaves less of such a lens; no lamp leaves less than a point spread."""
    shown = light_of(SCENE, model.heights(LINES))
    tails = [blurred(shown, blur_matrices(M, np.full(3, width), "cpu")) for width in (0.25, 0.9)]
    noise = NOISE * np.random.default_rng(0).standard_normal(shown.shape)
    seen = 0.7 * tails[0] + 0.3 * tails[1]
    run = run_with(model, CausticImage((seen.numpy() + noise).astype(np.float32), np.full(3, NOISE)), LINES + 1e-6)
    lines, view = run.lines, run.view
    assert view.camera.spread is None and view.discrepancy(view.relief(lines)) > LEAST_LEFT
    fit_with_lamp(run)
    assert run.lines is lines and run.view is view


def test_least_between():
    """Of a parabola its vertex, whatever the places; at an end the end."""
    values = {share: 2 + (share - 0.55) ** 2 for share in (0.0, 0.3, 0.7, 1.0)}
    assert least_between(values) == pytest.approx(0.55)
    assert least_between({share: 2 - share for share in (0.0, 0.3, 0.7, 1.0)}) == 1.0
    assert least_between({share: 2 - share + 0.3 * share**2 for share in (0.0, 0.3, 0.7, 1.0)}) == 1.0


def test_a_sharp_image_is_not_asked(model, monkeypatch):
    run = run_with(model, photographed(model, 0.0), LINES + 1e-6)
    monkeypatch.setattr(run, "on", lambda *_: pytest.fail("asked"))
    fit_with_lamp(run)
    assert run.numbers.scene is SCENE or run.numbers.scene == SCENE
