"""Steps by an image's noise with what a CPU does of them."""

import pytest

from nets.reconstruct.fibres.bench import noise_steps
from nets.reconstruct.fibres.bench.gap_fits import is_open
from nets.reconstruct.fibres.bench.noise_fits import fit_by_noise
from nets.reconstruct.fibres.bench.noise_steps import NoiseSteps
from tests.nets.reconstruct.fibres.test_bench_fits import bench_with
from tests.nets.reconstruct.fibres.test_noise_steps import FARTHER, left_as_told, way_of_light
from tests.nets.reconstruct.fibres.three_lines import SCENE, error_um
from warp_caustics.prints.model import LineModel

OF_CPU = noise_steps.EFFORTS["cpu"]


@pytest.fixture
def model():
    return LineModel(SCENE)


def test_a_cpu_finds_a_bench_that_was_left_as_told(model, monkeypatch):
    """By derivatives of fewer times, and pictures that are less fine."""
    true = bench_with(**FARTHER)
    run, kept = left_as_told(model, true), []
    slopes = NoiseSteps._slopes
    monkeypatch.setattr(NoiseSteps, "_slopes", lambda self, *at: kept.append(slopes(self, *at)) or kept[-1])
    shown, picture = [], NoiseSteps._picture
    monkeypatch.setattr(NoiseSteps, "_picture", lambda self, *args: shown.append(args) or picture(self, *args))
    told = fit_by_noise(run)
    assert told.is_more and error_um(model, run.lines) < 0.7
    assert way_of_light(run.bench) / way_of_light(true) == pytest.approx(1, abs=3e-3)
    assert len(kept) <= OF_CPU.rounds
    assert max(finer for *_, finer in (args for args in shown if len(args) == 3)) == OF_CPU.finer


def test_a_cpu_leaves_large_images_as_they_are(model, monkeypatch):
    monkeypatch.setitem(noise_steps.EFFORTS, "cpu", OF_CPU._replace(most_pixels=SCENE.image_pixels - 1))
    run = left_as_told(model, bench_with(**FARTHER))
    monkeypatch.setattr(NoiseSteps, "_picture", None)
    assert is_open(run) and not NoiseSteps(run).is_within_reach and fit_by_noise(run) is None
