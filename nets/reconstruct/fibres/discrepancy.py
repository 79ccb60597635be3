"""Discrepancy of a relief: what it leaves of the image, in units of the image's noise.

By Morozov's discrepancy principle a relief explains an image as soon as it leaves no more than noise; to fit the image
any better would be to fit the noise (Engl, Hanke & Neubauer, Regularization of Inverse Problems, section 4.3).
"""

import torch

from nets.reconstruct.fibres.image_fit import BORDER_PIXELS
from nets.reconstruct.fibres.search import FINE_PHOTONS_PER_PIXEL
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.pyramid import measurement_at, simulator_at
from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray

LARGEST_OF_NOISE = 1.5
"""Discrepancy below which nothing but noise is left: the true reliefs of six own plates have 1.00 to 1.23, those found
before the last descent 1.1 to 3.3. With a lattice of four photons per pixel the truth itself has up to 2.2."""


class Discrepancy:
    """RMS of simulated minus measured, in units of the measurement's noise.

    Args:
        scene: the set-up.
        image: what was measured.
        device: where to simulate.
    """

    def __init__(self, scene: Scene, image: CausticImage, device: str | torch.device):
        self.simulator = simulator_at(scene, scene.image_pixels, device, FINE_PHOTONS_PER_PIXEL)
        self.measurement = measurement_at(image, scene, scene.image_pixels, self.simulator.device, BORDER_PIXELS)

    def __call__(self, heights_m: FloatArray) -> float | None:
        """Of a relief [m], shape [n, n]; None if the noise of the image is unknown."""
        with torch.no_grad():
            heights = torch.tensor(heights_m, dtype=torch.float32, device=self.simulator.device)
            return self.measurement.discrepancy(self.simulator(heights))


def is_explained(left: float | None) -> bool:
    """Whether a discrepancy is nothing but noise; False if the noise is unknown."""
    return left is not None and left < LARGEST_OF_NOISE
