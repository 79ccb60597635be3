"""Steps by an image's noise with what a CPU does of them, and what they must gain of a picture of another size."""

import dataclasses

import pytest
import torch

from nets.reconstruct.fibres.bench import noise_steps
from nets.reconstruct.fibres.bench.gap_fits import deviations_asked, is_open, pulled_aside
from nets.reconstruct.fibres.bench.noise_fits import fit_by_noise
from nets.reconstruct.fibres.bench.noise_place import Place
from nets.reconstruct.fibres.bench.noise_steps import NoiseSteps
from tests.nets.reconstruct.fibres.test_bench_fits import NUMBERS, bench_with
from tests.nets.reconstruct.fibres.test_noise_steps import FARTHER, left_as_told, way_of_light
from tests.nets.reconstruct.fibres.three_lines import LINES, SCENE, error_um
from warp_caustics.found_bench.bench_numbers import AMBIENT
from warp_caustics.prints.model import LineModel

EFFORTS = dict(noise_steps.EFFORTS)
OF_CPU = EFFORTS["cpu"]


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

    def seen(self, bench, camera, finer=1, **options):
        shown.append(finer)
        return picture(self, bench, camera, finer, **options)

    monkeypatch.setattr(NoiseSteps, "_picture", seen)
    told = fit_by_noise(run)
    assert told.is_more and error_um(model, run.lines) < 0.7
    assert way_of_light(run.bench) / way_of_light(true) == pytest.approx(1, abs=3e-3)
    assert len(kept) <= OF_CPU.rounds
    assert max(shown) == OF_CPU.finer


@pytest.mark.parametrize("device", ["cpu", "cuda"])
def test_a_cpu_takes_derivatives_by_the_bench_once(model, monkeypatch, device):
    """Those of the look for hints serve for steps; a GPU takes them anew."""
    monkeypatch.setitem(noise_steps.EFFORTS, "cpu", OF_CPU._replace(renews_bench=EFFORTS[device].renews_bench))
    steps = NoiseSteps(left_as_told(model, bench_with(**FARTHER)))
    here, picture = steps._begin()
    steps.is_hinted()
    shown, plain = [], NoiseSteps.shown
    monkeypatch.setattr(NoiseSteps, "shown", lambda *about, **how: shown.append(about) or plain(*about, **how))
    steps._slopes(here, picture)
    by_pictures = set(NUMBERS.names) - {AMBIENT}
    assert len(shown) == (0 if device == "cpu" else 2 * len(by_pictures))


def test_a_cpu_leaves_large_images_as_they_are(model, monkeypatch):
    monkeypatch.setitem(noise_steps.EFFORTS, "cpu", OF_CPU._replace(most_pixels=SCENE.image_pixels - 1))
    run = left_as_told(model, bench_with(**FARTHER))
    monkeypatch.setattr(NoiseSteps, "_picture", None)
    assert is_open(run) and not NoiseSteps(run).is_within_reach and fit_by_noise(run) is None


def test_light_that_is_lost_is_followed_once(model, monkeypatch):
    """What it takes from the first picture is taken from all; lines on a plate as large as this lose none."""
    run = left_as_told(model, bench_with())
    run.numbers = dataclasses.replace(NUMBERS, scene=SCENE.model_copy(update={"second_hits": "lost"}))
    steps, plain = NoiseSteps(run), NoiseSteps.shown
    here = Place(LINES, model.shape, run.bench, run.view.camera)
    there = here._replace(lines=1.002 * here.lines)
    lost, followed = 0.01 * torch.rand(3, 128, 128, generator=torch.Generator().manual_seed(0)).double(), []

    def shown(self, *args, follows_light=True):
        followed.append(follows_light)
        return plain(self, *args) - follows_light * lost

    monkeypatch.setattr(NoiseSteps, "shown", shown)
    for _ in range(2):
        steps._follow(here)
    assert followed == [True, False]
    for place in (here, there):
        expected = plain(steps, model.heights(place.lines), place.bench, place.camera, OF_CPU.finer) - lost
        torch.testing.assert_close(steps._at(place), expected)
    assert followed == [True, False, False, False]


def test_pictures_that_do_not_follow_light_lose_none(model):
    run = left_as_told(model, bench_with())
    run.numbers = dataclasses.replace(NUMBERS, scene=SCENE.model_copy(update={"second_hits": "lost"}))
    steps, about = NoiseSteps(run), (run.bench, run.view.camera)
    scenes = [steps._picture(*about, follows_light=each)._light._fine.scene for each in (True, False)]
    assert [scene.second_hits for scene in scenes] == ["lost", "ignored"]


def test_a_gpu_follows_it_always(model, monkeypatch):
    monkeypatch.setitem(noise_steps.EFFORTS, "cpu", noise_steps.EFFORTS["cuda"])
    run = left_as_told(model, bench_with())
    run.numbers = dataclasses.replace(NUMBERS, scene=SCENE.model_copy(update={"second_hits": "lost"}))
    steps = NoiseSteps(run)
    here = Place(run.lines, model.shape, run.bench, run.view.camera)
    steps._follow(here)
    assert steps._lost is None
    shown = steps.shown(model.heights(run.lines), run.bench, run.view.camera, steps._finer)
    torch.testing.assert_close(steps._at(here), shown)


def test_what_a_picture_of_another_size_is_simulated_wrong_by_is_none_either(model):
    """It pulls gap and heights along their valley: three lines 0.8 um off went to 5.0 so."""
    run = left_as_told(model, bench_with(**FARTHER))
    steps, here = NoiseSteps(run), Place(run.lines, model.shape, run.bench, run.view.camera)
    picture = steps._at(here)
    usual = steps._least(here, picture)
    run.numbers = dataclasses.replace(run.numbers, is_picture=True)
    pulled = pulled_aside(run)
    assert steps._least(here, picture) == pytest.approx(usual + 100 * pulled**2) and pulled > 2
    assert deviations_asked(run, 4.0) == 4.0 + pulled
