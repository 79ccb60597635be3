"""Losses of light that a scene leaves out, found on images that have them and not on others."""

import numpy as np
import pytest
import torch

import nets.reconstruct.network_answers as answers_module
from nets.reconstruct.losses_of_light import effects_of, with_losses
from nets.reconstruct.methods import create
from tests.nets.reconstruct.exact_light import light_of
from warp_caustics.prints.model import LineModel
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator

N = 32
SCENE = Scene(height_samples=N, image_pixels=4 * N)
BOTH = {"fresnel": True, "second_hits": "lost"}
LINES = 1e-3 * torch.tensor([[-15.0, -12.0, 14.0, 9.0, 4.0, 1.6], [-9.0, 15.0, 10.0, -16.0, 4.0, 1.8]]).double()


def photographed(effects, light=light_of):
    """Lines with losses of light and noise: heights [m], and their image."""
    truth = LineModel(SCENE).heights(LINES)
    shown = light(SCENE.model_copy(update=effects), truth).numpy()
    noise = 0.005 * np.random.default_rng(0).standard_normal(shown.shape)
    return truth, CausticImage((shown + noise).astype(np.float32), np.full(3, 0.005))


def answer_nearly(monkeypatch, truth):
    """Networks answer what is 2 um off."""
    wrong = truth + 2e-6 * torch.randn(N, N, generator=torch.Generator().manual_seed(1))
    monkeypatch.setattr(
        answers_module, "Replayed", lambda module: lambda images: wrong.expand(len(images), N, N).clone()
    )


def test_the_least_is_taken_and_what_was_told_where_nothing_is_gained():
    asked = []

    def left(scene):
        asked.append(scene)
        return 1.0 - 0.1 * scene.fresnel

    assert effects_of(with_losses(SCENE, left)) == {"fresnel": True, "second_hits": "ignored"}
    assert len(asked) == 4
    assert with_losses(SCENE, lambda scene: 1.0) == SCENE
    assert effects_of(with_losses(SCENE, left, both=True)) == BOTH
    told = SCENE.model_copy(update={"fresnel": True})
    assert with_losses(told, lambda scene: 1.0 + scene.fresnel).fresnel, "never taken out"


@pytest.mark.parametrize("effects", [{}, BOTH])
def test_direct_finds_them_in_the_image(monkeypatch, saved, effects):
    """In one of its own lattice, whose error on so small a plate hides what losses do of any other."""
    truth, image = photographed(effects, lambda scene, heights: CausticSimulator(scene)(heights))
    answer_nearly(monkeypatch, truth)
    options = {"symmetries": False, "refine_pixels": 2 * N, "refine_iterations": 40, "causes": False}
    found = create("direct", SCENE, weights=saved("direct", scene=SCENE), losses=True, **options).reconstruct(image)
    assert found.counters["losses"] == effects_of(SCENE.model_copy(update=effects))
    if effects:
        without = create("direct", SCENE, weights=saved("direct", scene=SCENE), losses=False, **options)
        assert found.residual < 0.98 * without.reconstruct(image).residual


@pytest.mark.parametrize("effects", [{}, {"fresnel": True}])
def test_lines_are_found_with_them(monkeypatch, saved, effects):
    truth, image = photographed(effects)
    answer_nearly(monkeypatch, truth)
    weights = saved("direct", scene=SCENE)
    found = create("fibres", SCENE, weights=weights).reconstruct(image)
    assert found.counters["explained_by"] == "fibres" and "bench" not in found.counters
    assert found.counters.get("losses", {}).get("fresnel", False) == effects.get("fresnel", False)
    assert np.sqrt(np.mean((found.heights_m - truth.numpy()) ** 2)) < 3e-6
    if effects:
        # By noise alone another bench makes up for them.
        told = create("fibres", SCENE, weights=weights, losses=False, last_steps=False)
        without = told.reconstruct(image)
        assert "losses" not in without.counters
        assert found.counters["discrepancy"] < 0.99 * without.counters["discrepancy"]
