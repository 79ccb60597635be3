"""The refinement as it is shipped: long enough steps for what networks leave, and none where networks are sure."""

import numpy as np
import pytest
import torch

from nets.reconstruct.refinement import Refinement, RefinementOptions
from warp_caustics.prints.line import Line, line_relief
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.result import Resimulation
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator

SCENE = Scene(height_samples=32, image_pixels=128)
TRUTH = line_relief([Line((-0.015, -0.01), (0.012, 0.008), 8e-3, 1e-3)], 32, SCENE.plate_size_m)
LINE = TRUTH > 0
SURE_M = 5e-8
"""How wrong a network leaves bare plate, and how far its answers spread there."""


@pytest.fixture(scope="module")
def resimulation():
    """Of a single line seen with 1 % of noise."""
    simulator = CausticSimulator(SCENE)
    clean = simulator(torch.tensor(TRUTH, dtype=torch.float32)).numpy()
    noise = 0.01 * np.random.default_rng(0).standard_normal(clean.shape)
    return Resimulation(simulator, CausticImage((clean + noise).astype(np.float32), np.full(3, 0.01)))


def rms_um(heights):
    return 1e6 * float(np.sqrt(np.mean(heights**2)))


@pytest.fixture(scope="module")
def refined(resimulation):
    """From a line that is found 15 % too low, 150 um at its ridge, by a network that is unsure of lines alone."""
    method = Refinement(SCENE, RefinementOptions(), torch.device("cpu"))
    return method(resimulation, 0.85 * TRUTH, 0.0, None, np.where(LINE, 6e-5, SURE_M))


def test_the_usual_steps_take_away_half_of_what_a_network_leaves(refined):
    """In the number of steps that a CPU is given; shorter steps would not get there."""
    assert refined.is_better and len(refined.history) <= 105
    before, after = rms_um(0.15 * TRUTH), rms_um(refined.heights - TRUTH)
    assert before > 25 and after < 0.6 * before


def test_what_a_network_is_sure_of_is_left_alone(refined):
    """A descent on a noisy image would move bare plate by more than a network errs there."""
    moved = np.abs(refined.heights - 0.85 * TRUTH)
    assert moved[LINE].max() > 5e-5
    assert moved[~LINE].max() < SURE_M
