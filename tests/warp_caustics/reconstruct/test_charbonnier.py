"""The misfit of an image in one walk over its pixels, against torch in float64."""

import pytest
import torch

from warp_caustics.reconstruct.charbonnier import PIXELS_AT_ONCE, charbonnier_sum
from warp_caustics.reconstruct.objective import Measurement

SHAPE = 3, 61, 61
"""More pixels than are taken at once, and no multiple of that."""


def drawn(seed: int, dtype: torch.dtype = torch.float32) -> torch.Tensor:
    return torch.rand(SHAPE, generator=torch.Generator().manual_seed(seed), dtype=torch.float64).to(dtype)


@pytest.mark.parametrize("width", [0.01, 0.3])
def test_misfit_and_gradient_are_those_of_torch(width):
    assert drawn(0).numel() > PIXELS_AT_ONCE and drawn(0).numel() % PIXELS_AT_ONCE
    measurement = Measurement(drawn(1), (drawn(2) > 0.2).float(), None)
    image = drawn(0).requires_grad_()
    found = measurement.data_term(image, "charbonnier", width)
    (3.0 * found).backward()
    there = drawn(0, torch.float32).double().requires_grad_()
    residual = (there.float() - measurement.irradiance).double()
    expected = ((residual.square() + width**2).sqrt() - width) * measurement.weight
    (3.0 * expected.sum() / measurement.weight.sum()).backward()
    torch.testing.assert_close(found, expected.sum() / measurement.weight.double().sum(), rtol=1e-12, atol=0)
    torch.testing.assert_close(image.grad, there.grad.float(), rtol=1e-6, atol=0)
    assert float(image.grad.abs().max()) > 0 and not image.grad[measurement.weight == 0].any()


def test_a_gradient_is_made_only_where_one_is_asked_for():
    found = charbonnier_sum(drawn(0), drawn(1), drawn(2), 0.1)
    assert found is not None and not found.requires_grad


def test_other_images_are_left_to_torch():
    """Those in float64, of another shape than the measured one, and misfits that are not smooth."""
    single, double = drawn(0), drawn(0, torch.float64)
    assert charbonnier_sum(double, double, double, 0.1) is None
    assert charbonnier_sum(single[None], single, single, 0.1) is None
    assert charbonnier_sum(single, single, single, 0.0) is None
    measurement = Measurement(drawn(1, torch.float64), torch.ones(SHAPE, dtype=torch.float64), None)
    by_torch = measurement.data_term(double, "charbonnier", 0.1)
    in_one_walk = Measurement(drawn(1), torch.ones(SHAPE), None).data_term(single, "charbonnier", 0.1)
    torch.testing.assert_close(in_one_walk, by_torch, rtol=1e-6, atol=0)
