"""What is left of an image against what the stated uncertainty leaves of it."""

from dataclasses import replace

import numpy as np
import pytest
import torch

import nets.reconstruct.with_causes as module
from nets.reconstruct.direct import unlike_training
from nets.reconstruct.with_causes import looks_bare, with_causes
from tests.nets.reconstruct.exact_light import light_of
from tests.nets.reconstruct.fibres.three_lines import LINES, SCENE, N
from warp_caustics.prints.model import LineModel
from warp_caustics.reconstruct.base import CausticImage, Reconstruction
from warp_caustics.simulator import CausticSimulator

TIMES = 5.0


def ratio(is_exact, times, monkeypatch):
    """Of lines 5 um too high that state 1 um."""
    monkeypatch.setattr(module, "SEEN_TIMES", times)
    heights = LineModel(SCENE).heights(LINES)
    noise = 0.002 * np.random.default_rng(0).standard_normal((3, SCENE.image_pixels, SCENE.image_pixels))
    seen = CausticImage((light_of(SCENE, heights).numpy() + noise).astype(np.float32), np.full(3, 0.002))
    wrong = heights.double().numpy() * (1 + 5e-6 / float(heights.max()))
    found = Reconstruction("m", wrong, np.zeros((3, 1, 1)), 0.0, "converged", uncertainty_m=np.full(wrong.shape, 1e-6))
    simulator = CausticSimulator(SCENE, "lattice")
    return with_causes(found, seen, simulator, None, is_exact=is_exact).counters["rest"]["ratio"]


def test_explained_lines_may_leave_what_a_lens_does(monkeypatch):
    once, often = (ratio(True, times, monkeypatch) for times in (1.0, TIMES))
    assert once > 0 and often == pytest.approx(once / TIMES, rel=0.1)


def test_other_heights_may_leave_what_they_state(monkeypatch):
    assert ratio(False, 1.0, monkeypatch) == ratio(False, TIMES, monkeypatch) > 0


def with_drip(is_lines, drip_m=100e-6):
    """A result that lacks a drip on the bare part of the plate, and what it lacks [m], shape [n, n]."""
    heights = LineModel(SCENE).heights(LINES)
    x, y = (np.broadcast_to(axis, (N, N)) for axis in np.ogrid[:N, :N][::-1])
    drip = drip_m * np.exp(-((x - 27) ** 2 + (y - 9) ** 2) / 2)
    printed = heights + torch.from_numpy(drip).to(heights)
    noise = 0.01 * np.random.default_rng(0).standard_normal((3, SCENE.image_pixels, SCENE.image_pixels))
    seen = CausticImage((light_of(SCENE, printed).numpy() + noise).astype(np.float32), np.full(3, 0.01))
    found = Reconstruction(
        "m",
        heights.double().numpy(),
        np.zeros((3, 1, 1)),
        0.0,
        "converged",
        uncertainty_m=np.full((N, N), 1e-7),
        fibres_m=LINES.numpy() if is_lines else None,
    )
    return with_causes(found, seen, CausticSimulator(SCENE, "lattice"), None, is_exact=is_lines), drip


def test_what_lines_leave_of_even_light_is_in_their_uncertainty():
    found, drip = with_drip(is_lines=True)
    there, far = drip > 0.5 * drip.max(), drip < 1e-3 * drip.max()
    assert found.uncertainty_m[there].min() > 0.1 * drip.max() > 10 * np.median(found.uncertainty_m[far])
    assert found.counters["rest"]["relief_left_um"] > 0.15 * 1e6 * np.sqrt(np.mean(drip**2))
    assert any("of relief" in line and "in the uncertainty" in line for line in found.warnings)


def test_nothing_is_told_of_noise_or_of_heights_that_are_free():
    plain, _ = with_drip(is_lines=True, drip_m=0.0)
    free, _ = with_drip(is_lines=False)
    for found in (plain, free):
        assert "relief_left_um" not in found.counters["rest"] and not found.warnings
        assert found.uncertainty_m.max() == 1e-7


@pytest.mark.parametrize("is_bare", [True, False])
def test_networks_state_nothing_of_images_without_bright_lines(is_bare):
    """But of a bare plate, whose image is noise."""
    known = Reconstruction("m", np.zeros((4, 4)), np.zeros((3, 1, 1)), 0.02, "converged", uncertainty_m=np.ones((4, 4)))
    found = unlike_training(known, is_bare=is_bare)
    assert (found.uncertainty_m is not None) == is_bare != bool(found.no_uncertainty)
    assert any("no bright lines" in line for line in found.warnings)
    without = unlike_training(replace(known, uncertainty_m=None, no_uncertainty="one answer"), is_bare=is_bare)
    assert without.no_uncertainty == "one answer"


@pytest.mark.parametrize(("height_m", "is_bare"), [(0.0, True), (2e-4, False)])
def test_a_bare_plate_looks_so(height_m, is_bare):
    along = np.linspace(0, 6 * np.pi, N)
    hills = height_m * (1 + np.sin(along[:, None]) * np.sin(along)) / 2
    noise = 0.01 * np.random.default_rng(0).standard_normal((3, SCENE.image_pixels, SCENE.image_pixels))
    light = light_of(SCENE, torch.from_numpy(hills)).numpy()
    seen = CausticImage((light + noise).astype(np.float32), np.full(3, 0.01))
    found = Reconstruction("m", hills, np.zeros((3, 1, 1)), 0.0, "converged")
    assert looks_bare(found, seen, CausticSimulator(SCENE, "lattice")) == is_bare
