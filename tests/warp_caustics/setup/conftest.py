"""Plates for set-ups."""

import pytest
import torch

from warp_caustics.height_field import cell_centres


def bump(samples, height_m=4e-4, width_m=0.012, size_m=0.05):
    """A smooth hill beside the middle [m], shape [n, n]; weak enough that light paths do not cross."""
    place = torch.from_numpy(cell_centres(samples, size_m))
    x, y = place[None, :] - 2e-3, place[:, None] + 3e-3
    return height_m * torch.exp(-(x**2 + 1.3 * y**2 + 0.4 * x * y) / (2 * width_m**2))


@pytest.fixture
def heights():
    return bump(16)
