"""Caustics without the lattice's own error, against a much finer lattice."""

import numpy as np
import pytest
import torch

from warp_caustics.errors import InputError
from warp_caustics.extrapolated import ExtrapolatedCaustic
from warp_caustics.prints.model import LineModel
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator

SCENE = Scene(height_samples=48, image_pixels=192)
LINES = 1e-3 * torch.tensor([[-15.0, -12.0, 14.0, 9.0, 4.0, 0.7], [-9.0, 15.0, 10.0, -16.0, 3.2, 0.9]]).double()
PIXELS = SCENE.image_pixels**2


def lattice(per_pixel, scene=SCENE):
    return CausticSimulator(scene, "lattice", n_photons=per_pixel * PIXELS)


@pytest.mark.parametrize("times", [2, 4])
def test_most_of_the_error_goes(times):
    """Of photons N, 2 N and 4 N against 128 a pixel: less than half of what as many photons leave by themselves."""
    heights = LineModel(SCENE).heights(LINES)
    expected = lattice(128)(heights)

    def error(caustic):
        return float((caustic - expected).square().mean().sqrt())

    found = ExtrapolatedCaustic(lattice(8), times)(heights)
    assert error(found) < 0.5 * error(lattice(8 * times)(heights)) < 0.5 * error(lattice(8)(heights))


def test_light_is_kept_and_a_flat_plate_is_even():
    """To rounding, as by a lattice."""
    simulator = lattice(8)
    extrapolated = ExtrapolatedCaustic(simulator)
    heights = LineModel(SCENE).heights(LINES)
    assert float(extrapolated(heights).sum()) == pytest.approx(float(simulator(heights).sum()), rel=1e-4)
    flat = extrapolated(torch.zeros(48, 48))[:, 8:-8, 8:-8]
    np.testing.assert_allclose(flat.numpy(), 1.0, atol=2e-3)


def test_a_change_is_that_of_extrapolated_pictures():
    first, second = (LineModel(SCENE).heights(LINES * (1 + share)) for share in (0.0, 1e-3))
    extrapolated = ExtrapolatedCaustic(lattice(8))
    expected = extrapolated(second) - extrapolated(first)
    assert float((extrapolated.change(first, second) - expected).norm()) < 2e-3 * float(expected.norm())


def test_numbers_stay_as_precise():
    simulator = CausticSimulator(SCENE, "lattice", n_photons=PIXELS, dtype=torch.float64)
    assert ExtrapolatedCaustic(simulator)(torch.zeros(48, 48).double()).dtype == torch.float64


def test_other_photons_and_no_more_of_them_are_refused():
    with pytest.raises(InputError, match="random"):
        ExtrapolatedCaustic(CausticSimulator(SCENE, "lattice", placement="random", n_photons=1000))
    with pytest.raises(InputError, match="below 2"):
        ExtrapolatedCaustic(lattice(1), 1)
