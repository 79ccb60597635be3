"""Blocks of scattered photons and Gaussians in vector registers, against the kernels that take pixel by pixel."""

import pytest
import torch

from warp_caustics import CausticSimulator, Scene
from warp_caustics.kernels.blocks import BLOCK

SCENE = Scene(height_samples=20, image_pixels=48, exit_medium="glass")

ALL_EFFECTS = {"fresnel": True, "lamp_half_angle_rad": 0.02, "second_hits": "lost", "plate_size_m": (0.01, 0.01)}
"""On a plate so small that light meets narrow hills again."""

POINT = {
    "lamp_half_angle_rad": 0.0,
    "light_position_m": (4e-3, 2e-3, 0.1),
    "emission_half_angle_rad": 0.9,
    "lamp_radius_m": 0.015,
}

CASES = {
    "narrow": ({}, 1.0, 1500),
    "a row is one vector": ({}, 12.0, 1500),
    "rows of several vectors": ({"image_pixels": 200}, 40.0, 500),
    "far and off centre": ({"screen_position_m": (1e-3, -2e-3, -0.02), "exit_medium": "air"}, 6.0, 1500),
    "pixels fewer than a vector": ({"image_pixels": 5}, 12.0, 1500),
    "half out of sight": ({"screen_position_m": (0.009, -0.007, -1e-6)}, 12.0, 1500),
    "out of sight": ({"screen_position_m": (1.0, 0.0, -1e-6)}, 12.0, 1500),
    "fewer photons than a block": ({}, 12.0, 11),
    "all effects": (ALL_EFFECTS, 6.0, 1500),
    "all effects, tilt": ({**ALL_EFFECTS, "light_tilt_rad": (0.02, -0.01)}, 6.0, 1500),
    "all effects, point light": ({**ALL_EFFECTS, **POINT}, 6.0, 1500),
}


def relief(scene: Scene, dtype: torch.dtype) -> torch.Tensor:
    """Two of them, smooth and steep in places; narrow hills where light may meet them again."""
    n = scene.height_samples
    rough = torch.rand(2, 1, n, n, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    smooth = torch.nn.functional.avg_pool2d(rough, 3, 1, 1) if scene.second_hits == "ignored" else rough * (rough > 0.8)
    return (1.5e-3 * smooth * torch.linspace(0, 1, n) ** 2)[:, 0].to(dtype)


def made(scene: Scene, smoothing: float, n_photons: int, dtype: torch.dtype, by_pixel: bool = False):
    """A simulator, which takes one pixel after the other, as two threads of a GPU would, if asked for."""
    simulator = CausticSimulator(scene, "paper", n_photons=n_photons, smoothing=smoothing, dtype=dtype)
    if by_pixel:
        simulator.engine.fused.lanes = simulator.engine.fused.adjoint_lanes = 2
    return simulator


@pytest.mark.parametrize(
    ("name", "dtype"),
    [(name, torch.float64) for name in CASES]
    # Kernels with effects are compiled for float64 alone: an effect only adds code.
    + [(name, torch.float32) for name in CASES if not name.startswith("all effects")],
)
def test_blocks_and_vectors_change_nothing(name, dtype):
    """Image and gradient, to rounding: borders, windows of every width, all effects, other light."""
    changes, smoothing, n_photons = CASES[name]
    scene = Scene(**{**SCENE.model_dump(), **changes})
    simulator, other = (made(scene, smoothing, n_photons, dtype, by_pixel) for by_pixel in (False, True))
    assert simulator.engine.fused.in_blocks and n_photons % BLOCK
    heights = relief(scene, dtype)
    shape = 2, scene.n_wavelengths, scene.image_pixels, scene.image_pixels
    weights = torch.randn(shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64).to(dtype)
    tolerance = 1e-11 if dtype == torch.float64 else 2e-5
    for found, expected in (
        (simulator.engine.image(heights), other.engine.image(heights)),
        (simulator.engine.image_adjoint(heights, weights), other.engine.image_adjoint(heights, weights)),
    ):
        assert float((found - expected).abs().max()) <= tolerance * float(expected.abs().max())
        assert (float(expected.abs().max()) == 0) == (name == "out of sight")
    if name.startswith("all effects"):
        engine = simulator.engine
        ((_, positions),) = engine.chunks(2)
        assert (engine.clear_paths(engine.coefficients(heights), engine.photons(positions)) == 0).any()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_light_within_the_image_is_all_there(dtype):
    """The sum over pixels is that of the photons' light, however wide their footprints are."""
    for smoothing in (1.0, 12.0, 30.0):
        scene = SCENE.model_copy(update={"image_pixels": 64})
        simulator = made(scene, smoothing, 700, dtype)
        engine = simulator.engine
        heights = torch.zeros(1, 20, 20, dtype=dtype)
        ((chunk, positions),) = engine.chunks(1)
        inside = positions[(positions.abs() < 0.5 * 0.5 * scene.plate_size_m[0]).all(1)]
        assert 100 < len(inside) < 700
        image = torch.zeros(1, 3, 64, 64, dtype=dtype)
        engine.fused.splat(engine.coefficients(heights), engine.optics.photons(inside.contiguous()), image)
        records = engine.records(engine.maps(engine.coefficients(heights), chunk, positions), positions)
        light = records[0, :, 5, 0] * len(inside)
        torch.testing.assert_close(image[0].sum((1, 2)), light, rtol=1e-5 if dtype == torch.float32 else 1e-12, atol=0)
