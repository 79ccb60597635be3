"""Image and gradient of one objective for many reliefs, against one call after the other."""

import pytest
import torch

from warp_caustics import CausticSimulator, InputError, Scene
from warp_caustics.data_gradient import data_gradient
from warp_caustics.recorded_gradient import RecordedGradient

SCENE = Scene(height_samples=12, image_pixels=24)
ON_A_GPU = [pytest.mark.gpu, pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")]
DEVICES = ["cpu", pytest.param("cuda", marks=ON_A_GPU)]


def reliefs(count, device):
    generator = torch.Generator().manual_seed(5)
    return [1e-4 * torch.rand(12, 12, generator=generator).to(device) for _ in range(count)]


def objective_of(device):
    weights = torch.randn(3, 24, 24, generator=torch.Generator().manual_seed(1)).to(device)
    return lambda seen, heights: (weights * seen).sum() + 1e6 * heights.square().sum()


@pytest.mark.parametrize("device", DEVICES)
def test_as_called_one_by_one(device):
    simulator = CausticSimulator(SCENE, n_photons=40_000, device=device)
    objective = objective_of(device)
    recorded = RecordedGradient(simulator, objective)
    found = [recorded(heights) for heights in reliefs(5, device)]
    expected = [data_gradient(simulator, heights, objective) for heights in reliefs(5, device)]
    for one, other in zip(found, expected, strict=True):  # none is overwritten by later ones
        torch.testing.assert_close(one.image, other.image, rtol=2e-4, atol=2e-4)
        scale = float(other.gradient.abs().max())
        torch.testing.assert_close(one.gradient, other.gradient, rtol=0, atol=2e-4 * scale)
        assert float(one.value) == pytest.approx(float(other.value), rel=1e-3, abs=0.1)
    assert len({float(each.gradient[3, 3]) for each in found}) == 5


@pytest.mark.parametrize("device", DEVICES)
def test_reliefs_that_are_no_glass(device):
    """A GPU simulates before the host knows."""
    simulator = CausticSimulator(SCENE, device=device)
    recorded = RecordedGradient(simulator, objective_of(device))
    hole, none = reliefs(2, device)
    hole[3, 4], none[2, 5] = -1.0, float("nan")
    for number in range(4):
        assert torch.isfinite(recorded(none if number % 2 else hole).gradient).all()
        with pytest.raises(InputError, match="cuts through the plate"):
            simulator(hole)
        with pytest.raises(InputError, match=r"nan at index \[2, 5\]"):
            simulator(none)
    assert torch.isfinite(simulator(reliefs(1, device)[0])).all()
