"""Simulate, residual, gradient: against differences and autograd, with a camera, and for networks that say anything."""

import numpy as np
import pytest
import torch

from warp_caustics import CausticSimulator, Scene
from warp_caustics.data_gradient import (
    data_gradient,
    image_adjoint,
    lowest_height_m,
    possible_heights,
    squares_gradient,
)
from warp_caustics.errors import InputError
from warp_caustics.resampling import blur_matrices, blurred

SCENE = Scene(height_samples=12, image_pixels=24)


def bump(height_m, dtype=torch.float64):
    x = torch.linspace(-1, 1, 12, dtype=torch.float64)
    return (height_m * torch.exp(-8 * (x[None] ** 2 + x[:, None] ** 2))).to(dtype)


@pytest.fixture(scope="module")
def exact():
    return CausticSimulator(SCENE, dtype=torch.float64)


def mean_square(image, heights):
    """Data term and a prior in metres."""
    return ((image - 1.1) ** 2).mean() + 1e5 * (heights**2).mean()


@pytest.mark.parametrize("camera", [None, "blur", "mean"])
def test_gradient_against_differences(exact, camera):
    """Through a blur, a mean over wavelengths, or nothing; the prior counts too."""
    matrices = blur_matrices(24, np.array([0.5, 1.0, 1.5]), "cpu").double()
    through = {"blur": lambda u: blurred(u, matrices), "mean": lambda u: u.mean(0, keepdim=True)}.get(camera)
    heights, direction, step = bump(3e-4), bump(1.0).flip(0) + bump(0.5).roll(2, 1), 1e-8
    found = data_gradient(exact, heights, mean_square, through)
    ahead, behind = (
        float(data_gradient(exact, heights + s * step * direction, mean_square, through).value) for s in (1, -1)
    )
    assert float((found.gradient * direction).sum()) == pytest.approx((ahead - behind) / (2 * step), rel=1e-5)
    assert found.image.shape == ((1, 24, 24) if camera == "mean" else (3, 24, 24))
    assert not any(tensor.requires_grad for tensor in found)


def test_unchecked_is_the_same_and_checked_refuses(exact):
    """The type of the heights is that of the gradient."""
    checked, free = (data_gradient(exact, bump(3e-4), mean_square, is_checked=c) for c in (True, False))
    assert all(torch.equal(a, b) for a, b in zip(checked, free, strict=True))
    single = data_gradient(CausticSimulator(SCENE), bump(3e-4), mean_square)
    assert single.gradient.dtype == torch.float64 and single.image.dtype == torch.float32
    torch.testing.assert_close(single.gradient, checked.gradient, rtol=1e-3, atol=1e-3 * float(checked.gradient.std()))
    with pytest.raises(InputError, match="cuts through"):
        data_gradient(exact, bump(-1.0), mean_square)


def test_adjoint_of_the_image(exact):
    """<S'(h) u, v> = <u, S'(h)^T v>, S'(h) u by differences."""
    generator = torch.Generator().manual_seed(0)
    heights, u = bump(3e-4), torch.randn(12, 12, generator=generator, dtype=torch.float64)
    v = torch.randn(3, 24, 24, generator=generator, dtype=torch.float64)
    ahead, behind = (exact(heights + s * 1e-9 * u) for s in (1, -1))
    along = ((ahead - behind) / 2e-9 * v).sum()
    assert float((u * image_adjoint(exact, heights, v)).sum()) == pytest.approx(float(along), rel=1e-5)


def test_squares_are_what_autograd_says(exact):
    """A batch, without a denoiser; with one, its derivative counts as the identity."""
    heights, target = torch.stack([bump(3e-4), bump(1e-4)]), exact(torch.stack([bump(2e-4), bump(2e-4)]))
    leaf = heights.clone().requires_grad_()
    (0.5 * ((exact(leaf) - target) ** 2).sum() / 24**2).backward()
    image, gradient = squares_gradient(exact, heights, target)
    torch.testing.assert_close(image, exact(heights))
    torch.testing.assert_close(gradient, leaf.grad, rtol=1e-9, atol=1e-12)
    shown, twice = squares_gradient(exact, heights, target, lambda u: u + (u - target))
    torch.testing.assert_close(shown, 2 * image - target)
    torch.testing.assert_close(twice, 2 * gradient, rtol=1e-9, atol=1e-12)


def test_whatever_a_network_says_can_be_simulated(exact):
    wild = torch.tensor([float("nan"), float("inf"), -float("inf"), -1.0, 1.0, 1e-4], dtype=torch.float64)
    possible = possible_heights(wild, SCENE)
    assert possible[0] == 0 and possible[-1] == 1e-4
    assert possible.min() == lowest_height_m(SCENE) == pytest.approx(-0.9 * SCENE.base_thickness_m)
    heights = wild.repeat(24).reshape(1, 12, 12)
    image, gradient = squares_gradient(exact, heights, torch.ones(1, 3, 24, 24, dtype=torch.float64))
    assert image.isfinite().all() and gradient.isfinite().all()
