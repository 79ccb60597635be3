"""Reconstruction with a design, and the choice between reliefs part by part."""

import numpy as np
import pytest
import torch

from data_gen.fibres import Line, line_relief
from nets.reconstruct.from_design import DesignOptions, FromDesign
from nets.reconstruct.from_design_uncertainty import LINES, RELIEF, design_uncertainty
from nets.reconstruct.selection import MisfitMap, better_parts, parts
from warp_caustics.reconstruct.base import CausticImage, Reconstruction
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator

SCENE = Scene(height_samples=32, image_pixels=64)
TWO = [Line((-0.018, -0.015), (-0.018, 0.015), 5e-3, 3e-4), Line((0.015, -0.012), (0.015, 0.015), 5e-3, 2e-4)]


def relief(*lines):
    return line_relief(lines, 32, SCENE.plate_size_m)


@pytest.fixture(scope="module")
def simulator():
    return CausticSimulator(SCENE, "lattice")


def image_of(heights, simulator):
    return CausticImage(simulator(torch.tensor(heights, dtype=torch.float32)).numpy(), np.full(3, 0.01))


def test_misfit_is_where_the_relief_is_wrong(simulator):
    misfit = MisfitMap(simulator, image_of(relief(*TWO), simulator))
    assert misfit(relief(*TWO)).max() < 1e-6
    wrong = misfit(relief(TWO[0]))
    assert wrong[:, :12].sum() < 0.02 * wrong[:, 16:].sum()


def test_parts_are_connected_and_not_tiny():
    difference = np.zeros((32, 32))
    difference[2:5, 2:5] = 1e-4
    difference[5, 5] = -1e-4  # across the corner
    difference[20, 20] = 1e-4  # alone
    labels = parts(difference, 5e-5)
    assert labels.max() == 1 and (labels > 0).sum() == 10


def test_each_part_comes_from_the_relief_that_fits_there(simulator):
    """Either candidate lacks one of two lines."""
    misfit = MisfitMap(simulator, image_of(relief(*TWO), simulator))
    first, second = relief(TWO[0]), relief(TWO[1])
    found = better_parts(misfit, first, [second], SCENE.sample_pitch_m[0], rounds=2)
    assert np.abs(found - relief(*TWO)).max() < 5e-5 < np.abs(first - relief(*TWO)).max()
    assert misfit(found).sum() < 0.3 * misfit(first).sum()


def test_a_worse_candidate_changes_nothing(simulator):
    misfit = MisfitMap(simulator, image_of(relief(*TWO), simulator))
    found = better_parts(misfit, relief(*TWO), [relief(TWO[0]), np.zeros((32, 32))], SCENE.sample_pitch_m[0])
    np.testing.assert_array_equal(found, relief(*TWO))


class Free:
    """Stands in for a method that knows no design: answers what it is given."""

    name = "direct"

    def __init__(self, answer, spread):
        self.answer, self.spread = answer, spread

    def reconstruct(self, image, *, initial=None, progress=None):
        return Reconstruction("direct", self.answer, image.irradiance, 0.1, "converged", uncertainty_m=self.spread)


@pytest.fixture(scope="module")
def method():
    return FromDesign(SCENE, DesignOptions(coarse_iterations=0, iterations=3, step_m=1e-6))


@pytest.mark.parametrize("lines", [TWO, []])
def test_a_missing_fibre_is_found_and_the_design_corrects_the_rest(method, simulator, lines):
    """The free answer sees that the second line is missing, and errs on the first, which the design knows."""
    answer = relief(TWO[0]).copy()
    answer[8:14, 2:7] += 1e-4
    spread = np.full((32, 32), 1e-6)
    spread[8:14, 2:7] = 5e-5
    method.free = Free(answer, spread)
    found = method.reconstruct(image_of(relief(TWO[0]), simulator), relief(*TWO), lines)
    heights = found.reconstruction.heights_m
    assert np.abs(heights - relief(TWO[0])).max() < 3e-5
    assert len(found.lines) == len(lines)
    if lines:
        assert found.lines[1].line.height_m < 1e-5 and found.lines[0].height_error_m == pytest.approx(0, abs=1e-5)
    sigma = design_uncertainty(spread, LINES if lines else RELIEF)
    np.testing.assert_array_equal(found.reconstruction.uncertainty_m, sigma)


def test_ctrl_c_returns_what_is_there(method, simulator):
    def stop(state):
        raise KeyboardInterrupt

    method.free = Free(relief(*TWO), np.full((32, 32), 1e-6))
    found = method.reconstruct(image_of(relief(*TWO), simulator), relief(*TWO), progress=stop)
    assert found.reconstruction.stop_reason == "interrupted"


def test_uncertainty_grows_with_the_spread_and_has_a_floor():
    sigma = design_uncertainty(np.array([[0.0, 1e-6], [1e-5, 1e-4]]), LINES)
    assert sigma[0, 0] == LINES.floor_m and sigma[0, 1] == pytest.approx(LINES.scale_m)
    assert sigma[0, 1] < sigma[1, 0] < sigma[1, 1]
