"""The caustic of a plate on a screen far enough to see something."""

import numpy as np
import torch

from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator
from warp_caustics.types import FloatArray

FAR_SCREEN_M = 0.01
"""Distance of plate and screen in the pictures [m]; nothing is computed from them."""

FAR_PIXELS = 256


class FarScreen:
    """Caustics of reliefs of one scene with its screen moved away by :data:`FAR_SCREEN_M`.

    Args:
        scene: the set-up; its window and light stay.
        device: where to simulate.
    """

    def __init__(self, scene: Scene, device: str):
        x, y, _ = scene.screen_position_m
        pixels = min(FAR_PIXELS, scene.image_pixels)
        moved = scene.model_copy(update={"screen_position_m": (x, y, -FAR_SCREEN_M), "image_pixels": pixels})
        self.simulator = CausticSimulator(moved, device=device)

    def __call__(self, heights_m: FloatArray) -> FloatArray:
        """Irradiance [W/m^2], shape [n_w, k, k], of a relief [m], shape [n, n]."""
        heights = torch.from_numpy(heights_m.astype(np.float32)).to(self.simulator.device)
        with torch.no_grad():
            image: FloatArray = self.simulator(heights).cpu().numpy()
        return image
