"""In which order scattered photons come, and what becomes of their gradients, whatever it is."""

import pytest
import torch

from warp_caustics import CausticSimulator, Scene
from warp_caustics.gathered_adjoint import gathered_adjoint
from warp_caustics.photons import GROUP, sorted_by_cell

SCENE = Scene(height_samples=10, image_pixels=16, plate_size_m=(0.045, 0.03))


def engine(count):
    return CausticSimulator(SCENE, "paper", n_photons=count, dtype=torch.float64).engine


def cells(positions):
    return torch.floor(positions / torch.tensor(SCENE.sample_pitch_m)).long()


def in_order(positions):
    return positions[positions[:, 0].argsort()]


@pytest.mark.parametrize("count", [1, GROUP - 1, GROUP + 1, 40 * GROUP + 7])
def test_sorting_loses_nobody(count):
    positions = engine(count).plan.positions(next(iter(engine(count).plan.chunks(count))), torch.float64, "cpu")
    for is_spread in (False, True):
        assert torch.equal(in_order(sorted_by_cell(positions, SCENE, is_spread=is_spread)), in_order(positions))


def test_groups_hold_a_cell_or_two_and_their_neighbours_come_from_elsewhere():
    made = engine(400 * GROUP)
    positions = made.plan.positions(next(iter(made.plan.chunks(400 * GROUP))), torch.float64, "cpu")
    sorted_, spread = (sorted_by_cell(positions, SCENE, is_spread=which) for which in (False, True))
    groups = cells(spread).view(400, GROUP, 2)
    different = [len(set(map(tuple, group.tolist()))) for group in groups]
    assert max(different) <= 3 and sum(different) < 2 * 400
    # Nearest cells among eight groups that run together: in order of cells they overlap.
    first = groups[:, 0]
    apart = [(first[k + 1 : k + 8] - first[k]).abs().amax(1).min() for k in range(392)]
    assert min(apart) >= 1
    kept = cells(sorted_).view(400, GROUP, 2)[:, 0]
    assert min((kept[k + 1 : k + 8] - kept[k]).abs().amax(1).min() for k in range(392)) == 0


def test_gradient_of_the_coefficients_is_the_adjoint_of_the_maps():
    """<maps c, g> = <c, adjoint g>."""
    made, generator = engine(500), torch.Generator().manual_seed(0)
    chunk, positions = next(iter(made.chunks(2)))
    coefficients = torch.randn(2, 14, 14, generator=generator, dtype=torch.float64)
    grad = torch.randn(2, 6, chunk.count, generator=generator, dtype=torch.float64)
    maps = made.maps(coefficients, chunk, positions)
    found = gathered_adjoint((2, 14, 14), made.photons(positions), grad)
    expected = float((maps * grad).sum())
    assert float((coefficients * found).sum()) == pytest.approx(expected, rel=1e-12)
