"""Scenes and pictures for cameras."""

import numpy as np
import pytest
import torch

from warp_caustics.scene import Scene


def waves(width, height, period, shift_x=0.0, shift_y=0.0, dtype=torch.float64):
    """A band-limited picture, displaced exactly, shape [height, width]."""
    x = torch.arange(width, dtype=torch.float64)[None, :] - shift_x
    y = torch.arange(height, dtype=torch.float64)[:, None] - shift_y
    picture = 1 + 0.3 * torch.sin(2 * np.pi * x / period) + 0.2 * torch.cos(2 * np.pi * (x + 2 * y) / (3 * period))
    return picture.to(dtype)


@pytest.fixture
def scene():
    return Scene(image_pixels=24, height_samples=16)


@pytest.fixture
def image(scene):
    """Light as of a caustic: positive, uneven, of unlike channels, float64."""
    generator = torch.Generator().manual_seed(3)
    drawn = torch.rand(scene.n_wavelengths, 24, 24, generator=generator, dtype=torch.float64)
    return 0.2 + drawn**3 * 4
