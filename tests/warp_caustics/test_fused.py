"""Variants of the fused kernels that only GPUs use, run on the CPU: same image, same gradient."""

import pytest
import torch

from warp_caustics import CausticSimulator, Scene
from warp_caustics.kernels.fused_adjoint import fused_adjoint_kernels
from warp_caustics.kernels.fused_splat import fused_splat_kernels

SCENE = Scene(height_samples=10, image_pixels=20, screen_position_m=(1e-3, -2e-3, -0.02))


def image_and_gradient(lanes=1, defers=False, wide_pixels=None, profile="spline", placement="lattice"):
    """Simulate a batch of two with the fused kernels in the given variant."""
    simulator = CausticSimulator(
        SCENE, n_photons=900, smoothing=2.5, dtype=torch.float64, profile=profile, placement=placement
    )
    engine, fused = simulator.engine, simulator.engine.fused
    variant = engine.warp_dtype, profile, lanes, placement == "lattice", defers
    fused.lanes = fused.adjoint_lanes = lanes
    fused.defers = defers
    fused.kernels, fused.adjoint_kernels = fused_splat_kernels(*variant), fused_adjoint_kernels(*variant)
    if wide_pixels is not None:
        engine.optics.wide_pixels = wide_pixels
    generator = torch.Generator().manual_seed(0)
    heights = 2e-4 * torch.randn(2, 10, 10, generator=generator, dtype=torch.float64).abs()
    weights = torch.randn(2, 3, 20, 20, generator=generator, dtype=torch.float64)
    leaf = heights.requires_grad_()
    image = simulator(leaf)
    (image * weights).sum().backward()
    return image.detach(), leaf.grad


@pytest.mark.parametrize("placement", ["lattice", "random"])
@pytest.mark.parametrize(
    "variant",
    [
        {"lanes": 4},
        {"defers": True, "wide_pixels": 0.0},
        {"defers": True, "wide_pixels": 6.0},
        {"lanes": 2, "defers": True, "wide_pixels": 6.0},
    ],
    ids=["several lanes", "all deferred", "some deferred", "lanes and deferred"],
)
@pytest.mark.parametrize("profile", ["spline", "gaussian"])
def test_variant_changes_nothing(placement, variant, profile):
    """Sharing a footprint between threads, or leaving it to another kernel, only changes the order of sums."""
    expected = image_and_gradient(profile=profile, placement=placement)
    found = image_and_gradient(profile=profile, placement=placement, **variant)
    for a, b in zip(found, expected, strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=1e-12 * float(b.abs().max()))


def test_nothing_is_deferred_unless_asked_for():
    """The list of deferred footprints stays unread on the CPU; leaving them out would lose light."""
    lost, _ = image_and_gradient(wide_pixels=0.0)
    kept, _ = image_and_gradient()
    assert torch.equal(lost, kept)
