"""A lens and stray light, each of which makes up for the other."""

import dataclasses

import numpy as np
import pytest

from nets.reconstruct.fibres.bench.bench_and_light import Bench, seen_on
from nets.reconstruct.fibres.bench.bench_of_lines import BenchOfLines, numbers_of_lines
from nets.reconstruct.fibres.bench.camera_of_lines import fit_through_lens, with_spread_of
from nets.reconstruct.fibres.bench.lens_or_light import fit_through_lens_or_with_light
from nets.reconstruct.fibres.image.lines_view import LinesView
from tests.nets.reconstruct.cameras import blurring, through_lens
from tests.nets.reconstruct.fibres.line_run import line_run
from tests.nets.reconstruct.fibres.three_lines import LINES, SCENE
from warp_caustics.found_bench.bench_numbers import AMBIENT, BenchNumbers
from warp_caustics.prints.model import LineModel
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.result import Resimulation
from warp_caustics.simulator import CausticSimulator

LENS_PX, NOISE, LINES_OFF = 0.3, 0.01, 3e-6


@pytest.fixture(scope="module")
def model():
    return LineModel(SCENE)


def run_with(model, stray, stray_found=0.0):
    """On a bench that was found with other stray light, lines 3 um off."""
    seen = through_lens(SCENE, model.heights(LINES), LENS_PX, NOISE)
    level = np.asarray(SCENE.radiosity_W_m2, np.float32)[:, None, None]
    image = CausticImage((seen.irradiance + stray * level) / (1 + stray), seen.noise_std / (1 + stray))
    numbers = numbers_of_lines(BenchNumbers.of(SCENE))
    told = Bench.told(numbers)

    def on(bench, camera=None):
        there = Resimulation(CausticSimulator(numbers.scene_of(bench.values)), seen_on(image, numbers, bench))
        if camera is None:
            camera = with_spread_of(there.found_camera(run.view.relief(run.lines), exactly=True), run.view.camera)
        return LinesView(there.through(camera), model)

    def together(names=None):
        asked = numbers if names is None else numbers.only(names)
        return BenchOfLines(asked, image, model, SCENE.image_pixels // 2, run.view.camera)

    bench = dataclasses.replace(told, values=dict(told.values) | {AMBIENT: stray_found})
    run = line_run(model=model, lines=LINES + LINES_OFF, bench=bench, numbers=numbers, on=on, together=together)
    run.is_elsewhere, run.note, run.search = True, lambda loss: None, lambda lines, jumps: None
    run.view = on(bench, blurring(LENS_PX, SCENE.image_pixels))
    return run


def off(run):
    """Root mean square of what heights are off by [m]."""
    return (run.model.heights(run.lines) - run.model.heights(LINES)).square().mean().sqrt()


def test_stray_light_is_not_a_lens(model):
    """5 % where none was found: weights that sharpen leave as little, on lines that are farther off."""
    by_lens, run = run_with(model, 0.05), run_with(model, 0.05)
    fit_through_lens(by_lens)
    fit_through_lens_or_with_light(run)
    assert run.bench.values[AMBIENT] > 0.03
    assert run.view.is_explained(run.lines)
    assert off(run) < 0.7 * off(by_lens)


def test_a_lens_is_not_stray_light(model):
    """Where a bench has none beyond it, lines tell the same as if that were not asked."""
    by_lens, run = run_with(model, 0.0), run_with(model, 0.0)
    fit_through_lens(by_lens)
    fit_through_lens_or_with_light(run)
    assert run.view.camera.spread is not None
    np.testing.assert_allclose(run.view.camera.spread.lens_px, LENS_PX, atol=0.05)
    assert run.bench.values == by_lens.bench.values


def test_an_interrupted_fit_keeps_the_lens(model):
    """Where the time is over while light is asked for."""
    run = run_with(model, 0.05)
    bench = run.bench

    def stop(names=None):
        raise KeyboardInterrupt

    run.together = stop
    with pytest.raises(KeyboardInterrupt):
        fit_through_lens_or_with_light(run)
    assert run.bench is bench
