"""Three crossing lines on a small scene, and their image."""

import numpy as np
import torch

from tests.nets.reconstruct.exact_light import light_of
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.scene import Scene

N = 32
SCENE = Scene(height_samples=N, image_pixels=4 * N)
LINES = 1e-3 * torch.tensor(
    [[-15.0, -12.0, 14.0, 9.0, 4.0, 0.7], [-9.0, 15.0, 10.0, -16.0, 3.2, 0.9], [-18.0, 5.0, 17.0, 15.0, 4.4, 0.5]],
    dtype=torch.float64,
)


def noisy_image(model):
    """With 1 % noise."""
    simulated = light_of(model.scene, model.heights(LINES)).numpy()
    noise = np.random.default_rng(0).standard_normal(simulated.shape)
    return CausticImage((simulated + 0.01 * noise).astype(np.float32), np.full(3, 0.01))


def error_um(model, lines, expected=LINES):
    return 1e6 * float((model.heights(lines) - model.heights(expected)).square().mean().sqrt())
