"""What is left of an image against what the stated uncertainty leaves of it."""

import numpy as np
import pytest

import nets.reconstruct.with_causes as module
from nets.reconstruct.with_causes import with_causes
from tests.nets.reconstruct.exact_light import light_of
from tests.nets.reconstruct.fibres.three_lines import LINES, SCENE
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
