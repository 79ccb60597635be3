"""Averaging over turns and flips."""

import pytest
import torch

from nets.reconstruct.symmetries import all_symmetries, seen_in, turned_back
from warp_caustics.scene import Scene

MAPS = torch.rand(3, 6, 6, generator=torch.Generator().manual_seed(1))


@pytest.mark.parametrize(
    ("changes", "count"),
    [
        ({}, 8),
        ({"plate_size_m": (0.05, 0.04)}, 4),
        ({"screen_position_m": (1e-3, 0.0, -1e-6)}, 2),
        ({"screen_position_m": (1e-3, 1e-3, -1e-6)}, 1),
        ({"emission_half_angle_rad": 0.1, "light_position_m": (0.0, 0.01, 1.0)}, 2),
    ],
)
def test_only_symmetries_that_the_scene_has(changes, count):
    symmetries = all_symmetries(Scene(**changes))
    assert symmetries.shape == (3, count)
    assert not symmetries[:, 0].any()
    assert len({tuple(column) for column in symmetries.T.tolist()}) == count


def test_all_eight_differ_and_turn_back():
    symmetries = all_symmetries(Scene())
    seen = seen_in(MAPS, symmetries)
    assert all(not torch.equal(seen[a], seen[b]) for a in range(8) for b in range(a))
    assert torch.equal(turned_back(seen, symmetries), MAPS.expand(8, -1, -1, -1))


def test_mean_of_an_equivariant_network_is_its_answer():
    """A 3 x 3 mean commutes with turns and flips; a shift by one does not, and its mean differs."""
    symmetries = all_symmetries(Scene())

    def blurred(x):
        return torch.nn.functional.avg_pool2d(x, 3, 1, 1)

    def shifted(x):
        return x.roll(1, dims=-1)

    for network, is_equal in ((blurred, True), (shifted, False)):
        mean = turned_back(network(seen_in(MAPS, symmetries)), symmetries).mean(0)
        assert torch.allclose(mean, network(MAPS[None])[0], atol=1e-6) == is_equal
