"""Scenes and pictures for cameras."""

import numpy as np
import pytest
import torch

from warp_caustics.camera.config import CameraConfig
from warp_caustics.camera.operator import Camera
from warp_caustics.scene import Scene

EVERYTHING = CameraConfig(
    psf_px=(0.4, 0.5, 0.7),
    box_px=0.3,
    frame_px=(40, 36),
    shift_px=(0.31, -0.43),
    turn_rad=0.03,
    magnification=1.3,
    homography=((1.01, 0.02, 0.01), (-0.03, 0.99, 0.02), (0.02, -0.03, 1.0)),
    colour_shift_px=((0.3, 0.1), (0.0, 0.05), (-0.2, 0.17)),
    colour_scale=(0.001, 0.0, -0.002),
    light=((0.05, 0.02, 0.03, -0.01, 0.02), (0.04, 0.0, 0.0, 0.0, 0.01), (0.0, 0.0, 0.02, 0.0, 0.0)),
    ambient=(0.03, 0.02, 0.01),
    mixing=((0.9, 0.1, 0.0), (0.05, 0.9, 0.05), (0.0, 0.1, 0.9)),
    gain=(1.0, 1.1, 0.8),
)
UPRIGHT = EVERYTHING.model_copy(update={"turn_rad": 0.0, "homography": None})
WINDOW = UPRIGHT.model_copy(update={"frame_px": None, "magnification": 1.0})


def drawn(*shape, seed=0):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def camera(config, scene, **more):
    return Camera(config, scene, dtype=torch.float64, **more)


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
