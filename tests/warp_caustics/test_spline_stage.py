"""Large reliefs go through the linear stage by blocks: the same numbers as by whole matrices."""

import math

import pytest
import torch

from warp_caustics import CausticSimulator, Scene, spline_stage
from warp_caustics.banded import BLOCK_ROWS
from warp_caustics.extremes import Extremes
from warp_caustics.height_field import PREFILTER_REACH
from warp_caustics.lattice_adjoint import LatticeAdjoint
from warp_caustics.spline_stage import SplineStage

N = 2 * BLOCK_ROWS + 90
"""Samples: three blocks, the last one a rest."""


def engine(monkeypatch, by_blocks: bool, rows: bool = False):
    """Of a lattice with more photons than samples along x and fewer along y, so that blocks overlap otherwise."""
    monkeypatch.setattr(spline_stage, "MAX_WHOLE_SAMPLES", 0 if by_blocks else N)
    scene = Scene(height_samples=N, image_pixels=16, plate_size_m=(0.045, 0.02))
    made = CausticSimulator(scene, n_photons=700 * 310, dtype=torch.float64).engine
    if not rows:
        made.rows = None
    assert made.spline.by_blocks == by_blocks
    return made


def noise(*shape: int) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(len(shape)), dtype=torch.float64)


def assert_close(found, expected):
    assert float((found - expected).abs().max()) <= 1e-12 * float(expected.abs().max())


def test_coefficients_and_their_adjoint(monkeypatch):
    """By blocks, by whole matrices, and by the kernel that looks no farther than the filter reaches."""
    blocks, whole, kernel = engine(monkeypatch, True), engine(monkeypatch, False), engine(monkeypatch, False, True)
    heights, grad = noise(2, N, N), noise(2, N + 4, N + 4)
    for other in (blocks, kernel):
        assert_close(other.coefficients(heights), whole.coefficients(heights))
        assert_close(other.coefficients_adjoint(grad), whole.coefficients_adjoint(grad))


@pytest.mark.parametrize(("dtype", "exact"), [(torch.float64, 1e-12), (torch.float32, 1e-6)])
def test_kernels_of_a_gpu_look_as_far_as_they_must(monkeypatch, dtype, exact):
    """Both ways, which on a GPU take the place of products with whole matrices."""
    spline = engine(monkeypatch, False).spline
    for matrix, other, planes in (
        (spline.prefilter, spline.prefilter_transposed, noise(2, N, N)),
        (spline.prefilter_transposed, spline.prefilter, noise(2, N + 4, N + 4)),
    ):
        found = spline.filtered(planes.to(dtype), matrix.to(dtype), other.to(dtype)).double()
        expected = matrix @ planes @ other
        assert float((found - expected).abs().max()) <= exact * float(expected.abs().max())


def test_kernels_of_a_gpu_bring_heights_within_their_ends(monkeypatch):
    """What is no number becomes the lowest: as torch does it before the product."""
    spline = engine(monkeypatch, False).spline
    heights = noise(1, N, N)
    heights[0, 3, 4], heights[0, 50, 60], heights[0, 7, 7] = float("nan"), float("inf"), -float("inf")
    found = spline.filtered(heights, spline.prefilter, spline.prefilter_transposed, (-0.5, 1.0))
    assert_close(found, spline.coefficients(heights.nan_to_num(nan=-0.5).clamp(-0.5, 1.0)))
    assert_close(found, spline.coefficients(heights, (-0.5, 1.0)))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_kernels_of_a_gpu_tell_what_the_heights_are(monkeypatch, dtype):
    """Of one set after the other, whichever row and column holds the lowest and highest, and of what is no number."""
    spline = engine(monkeypatch, False).spline
    stage = SplineStage(spline._plan, lambda values: torch.as_tensor(values, dtype=dtype))
    extremes = Extremes(torch.device("cpu"), dtype)
    ends = (-0.5, 1.0)
    for place in ((0, 0), (0, N - 1), (N - 1, 3), (N // 2, 7), (40, N - 2), (N - 2, N - 2)):
        heights = 0.1 * noise(2, N, N).to(dtype)
        heights[(0, *place)], heights[(1, *place[::-1])] = -3.0, 4.0
        extremes.ask(heights)
        found = stage.asked_coefficients(2, extremes, ends)
        assert extremes.read() == (-3.0, 4.0)
        torch.testing.assert_close(found, stage.filtered(heights, stage.prefilter, stage.prefilter_transposed, ends))
        for wrong in (float("nan"), float("inf"), -float("inf")):
            heights[(1, *place)] = wrong
            extremes.ask(heights)
            found = stage.asked_coefficients(2, extremes, ends)
            assert not all(map(math.isfinite, extremes.read()))
            assert torch.isfinite(found).all()


def test_maps_of_a_lattice_and_their_adjoint(monkeypatch):
    """Of a chunk that begins within the lattice."""
    blocks, whole = engine(monkeypatch, True), engine(monkeypatch, False)
    chunk = list(whole.plan.chunks(170 * whole.plan.columns))[1]
    assert chunk.first_row > 0 and chunk.rows < whole.plan.rows
    coefficients = noise(2, N + 4, N + 4)
    positions = whole.positions(chunk)
    expected = whole.maps(coefficients, chunk, positions)
    assert_close(blocks.maps(coefficients, chunk, positions), expected)
    grad = noise(*expected.shape)
    assert_close(blocks.maps_adjoint(coefficients, chunk, grad), whole.maps_adjoint(coefficients, chunk, grad))


@pytest.mark.parametrize("photons", [(700, 310), (211, 90)])
def test_coefficients_gather_from_the_photons_they_act_on(photons):
    """As a GPU does it; fewer photons than samples leave coefficients that act on none."""
    scene = Scene(height_samples=N, image_pixels=16, plate_size_m=(0.045, 0.02))
    made = CausticSimulator(scene, n_photons=photons[0] * photons[1], dtype=torch.float64).engine
    spline, plan = made.spline, made.plan
    gather = LatticeAdjoint(plan, spline._tensor)
    chunks = list(plan.chunks(plan.count // 3))
    assert len(chunks) > 2
    for chunk in chunks:
        grad = noise(2, 6, chunk.rows, plan.columns)
        assert_close(gather(grad, chunk), spline.maps_adjoint(grad, chunk))


@pytest.mark.parametrize("n", [600, 1200])
def test_blocks_hold_what_grows_with_the_samples(n):
    """Entries that are kept for an axis: a band, not the square."""
    scene = Scene(height_samples=n, image_pixels=16)
    spline = CausticSimulator(scene, n_photons=100).engine.spline
    kept = sum(block.entries.numel() for block in spline._prefilter_blocks.blocks)
    assert kept <= (n + 4) * (BLOCK_ROWS + 2 * PREFILTER_REACH)
