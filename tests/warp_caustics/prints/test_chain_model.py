"""Lines along chains of points, against printed paths in double precision and against differences."""

import numpy as np
import pytest
import torch

from warp_caustics.prints.chain_kernels import BLOCK
from warp_caustics.prints.chain_model import ChainModel
from warp_caustics.prints.curves import bezier_points, meander_points, ring_points
from warp_caustics.prints.line_shape import Shape
from warp_caustics.prints.model import LineModel
from warp_caustics.prints.paths import paths_relief, uniform_path
from warp_caustics.scene import Scene

SCENE = Scene(height_samples=64, image_pixels=64, plate_size_m=(0.05, 0.04))
CURVE = bezier_points(1e-3 * np.array([[-20.0, 0.0], [0.0, 25.0], [10.0, -30.0], [20.0, 10.0]]))
MEANDER = meander_points((2e-3, -4e-3), 1.5e-2, 3e-3, 4, 0.3)
RING = ring_points((-1e-2, -8e-3), 5e-3)
CORNER = 1e-3 * np.array([[-5.0, 15.0], [4.0, 15.0], [4.0, 2.0]])
DROP = 1e-3 * np.array([[15.0, -12.0]])
WAYS = (CURVE, MEANDER, RING, CORNER, DROP)
SIZES = 1e-3 * np.array([[2.0, 0.5], [1.1, 0.3], [2.6, 0.8], [1.5, 0.4], [3.0, 0.6]])
SHAPES = (Shape(), Shape(1.2, 0.3, 0.5), Shape(is_cap=True), Shape(overlap=0.0), Shape(5.0, cut=0.08))


def filled(ways=WAYS):
    """Points of all ways, the last repeated, shape [L, K, 2]."""
    most = max(map(len, ways))
    return np.stack([np.concatenate([way, np.repeat(way[-1:], most - len(way), 0)]) for way in ways])


def chains_of(shape, device="cpu"):
    model = LineModel(SCENE, device=device)
    model.shape = shape
    return ChainModel(model)


def test_heights_are_those_of_printed_paths():
    """Corners, a closed line and the turns of a meander are not doubled; different lines are."""
    paths = [uniform_path(way, *size) for way, size in zip(WAYS, SIZES, strict=True)]
    expected = paths_relief(paths, 64, SCENE.plate_size_m)
    found = chains_of(Shape()).heights(filled(), SIZES).double().numpy()
    np.testing.assert_allclose(found, expected, atol=5e-9)
    assert expected.max() > 8e-4


def test_a_chain_of_two_points_is_a_line():
    lines = 1e-3 * torch.tensor([[-10.0, 3.0, 12.0, -7.0, 2.9, 0.8], [1.0, 2.0, 5.0, 5.0, 1.3, 1.0]]).double()
    for shape in SHAPES:
        chains = chains_of(shape)
        parts = chains.parts(chains.placed(lines[:, :4].reshape(2, 2, 2).numpy(), lines[:, 4:].numpy()))
        torch.testing.assert_close(parts, chains.model.parts(lines)[0], rtol=0, atol=2e-9)
        relief = chains.heights(lines[:, :4].reshape(2, 2, 2).numpy(), lines[:, 4:].numpy())
        torch.testing.assert_close(relief, chains.model.heights(lines), rtol=0, atol=2e-9)


@pytest.mark.parametrize("count", [1, 2, BLOCK, BLOCK + 1, BLOCK + 2])
def test_any_number_of_points(count):
    """Blocks are filled up by the last point, and its gradient is that of all that stand for it."""
    points = np.linspace([-8e-3, 1e-3], [9e-3, 5e-3], count)[None]
    chains = chains_of(Shape())
    placed = chains.placed(points, np.array([[2e-3, 5e-4]]))
    parts = chains.parts(placed)
    assert float(parts.amax()) == pytest.approx(5e-4, rel=0.3)
    weight = torch.from_numpy(np.mgrid[0:64, 0:64][1].astype(np.float32))
    by_point, _ = chains.gradient(placed, parts, weight)
    assert by_point.shape == points.shape
    # Moved as a whole to the right by a sample the sum of heights times columns grows by the volume.
    assert float(by_point[..., 0].sum()) * SCENE.sample_pitch_m[0] == pytest.approx(float(parts.sum()), rel=0.01)


def test_no_chain_prints_nothing():
    chains = chains_of(Shape())
    assert not chains.heights(np.zeros((0, 2, 2)), np.zeros((0, 2))).any()


@pytest.mark.parametrize("shape", SHAPES)
def test_gradient_by_points_and_sizes(shape):
    """Against differences of a weighted sum of heights, all chains moved at once."""
    chains, points, sizes = chains_of(shape), filled(), SIZES
    placed = chains.placed(points, sizes)
    rng = np.random.default_rng(2)
    smooth = np.cos(np.mgrid[0:64, 0:64].transpose(1, 2, 0) @ rng.uniform(0.1, 0.4, (2, 3))).sum(-1)
    weight = torch.from_numpy(smooth.astype(np.float32))
    by_point, by_size = chains.gradient(placed, chains.alone(placed), weight)
    turns = rng.uniform(0, 2 * np.pi, (len(WAYS), 1, 2))
    moved = np.sin(400 * points + turns)
    grown = rng.standard_normal(sizes.shape)

    def value(step):
        found = chains.heights(points + step * moved, sizes + step * grown)
        return float((found.double() * weight.double()).sum())

    step = 4e-6
    expected = (value(step) - value(-step)) / (2 * step)
    found = float((by_point * moved).sum() + (by_size * grown).sum())
    assert found == pytest.approx(expected, rel=0.05 if shape.is_cap else 0.01)


@pytest.mark.gpu
def test_a_gpu_agrees():
    if not torch.cuda.is_available():
        pytest.skip("needs a CUDA device")
    weight, found = torch.randn(64, 64, generator=torch.Generator().manual_seed(1)), []
    for device in ("cpu", "cuda"):
        chains = chains_of(SHAPES[1], device)
        placed = chains.placed(filled(), SIZES)
        alone = chains.alone(placed)
        assert alone.device.type == device
        found.append((alone.cpu().numpy(), *chains.gradient(placed, alone, weight.to(device))))
    for one, other in zip(*found, strict=True):
        assert np.linalg.norm(one - other) <= 2e-3 * np.linalg.norm(one)


def test_chains_alone_are_those_among_others():
    """Blocks that others need, and these fill up, change neither a relief nor what is asked of it."""
    chains = chains_of(SHAPES[1])
    together = chains.placed(filled(), SIZES)
    weight = torch.randn(len(WAYS), 64, 64, generator=torch.Generator().manual_seed(3))
    of_points, of_sizes = chains.gradient_of_each(together, weight)
    parts = chains.parts(together)
    for k, way in enumerate(WAYS):
        alone = chains.placed(way[None], SIZES[[k]])
        torch.testing.assert_close(chains.parts(alone)[0], parts[k], rtol=0, atol=0)
        by_point, by_size = chains.gradient_of_each(alone, weight[[k]])
        np.testing.assert_allclose(by_size[0], of_sizes[k], rtol=1e-4)
        expected = of_points[k, : len(way)].copy()
        expected[-1] += of_points[k, len(way) :].sum(axis=0)
        np.testing.assert_allclose(by_point[0], expected, rtol=1e-4, atol=1e-5 * np.abs(expected).max())
