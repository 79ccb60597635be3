"""Discrepancy of a relief: what it leaves of the image, in units of the image's noise.

By Morozov's discrepancy principle a relief explains an image as soon as it leaves no more than noise; to fit the image
any better would be to fit the noise (Engl, Hanke & Neubauer, Regularization of Inverse Problems, section 4.3).
"""

import dataclasses

import numpy as np
import torch

from nets.reconstruct.fibres.image_fit import BORDER_PIXELS, FINE_PHOTONS_PER_PIXEL
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.pyramid import measurement_at, simulator_at
from warp_caustics.resampling import blur_matrices, blurred
from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray

LARGEST_OF_NOISE = 1.5
"""Discrepancy below which nothing but noise is left: the true reliefs of six own plates have 1.00 to 1.23, those found
before the last descent 1.1 to 3.3. With a lattice of four photons per pixel the truth itself has up to 2.2."""

LATTICE_ERROR = 0.01
"""Error of a simulation with ``FINE_PHOTONS_PER_PIXEL``, relative to the irradiance: four own plates without noise have
0.15 to 1.1 % RMS, those with most folds the most. An image without noise is explained when no more than it is left."""


class Discrepancy:
    """RMS of simulated minus measured, in units of the measurement's noise or the simulation's error, the larger one.

    Args:
        scene: the set-up.
        image: what was measured.
        device: where to simulate.
        blur_px: standard deviation of the camera's blur [px], shape [n_w]; None for none.
    """

    def __init__(
        self, scene: Scene, image: CausticImage, device: str | torch.device, blur_px: FloatArray | None = None
    ):
        self.simulator = simulator_at(scene, scene.image_pixels, device, FINE_PHOTONS_PER_PIXEL)
        plain = measurement_at(image, scene, scene.image_pixels, self.simulator.device, BORDER_PIXELS)
        self._blur = None
        if blur_px is not None and np.any(blur_px):
            self._blur = blur_matrices(scene.image_pixels, blur_px, self.simulator.device)
        noise = plain.noise
        if noise is not None:
            noise = torch.maximum(noise, LATTICE_ERROR * plain.irradiance.double())
        self.measurement = dataclasses.replace(plain, noise=noise)

    def __call__(self, heights_m: FloatArray) -> float | None:
        """Of a relief [m], shape [n, n]; None if the noise of the image is unknown."""
        with torch.no_grad():
            heights = torch.tensor(heights_m, dtype=torch.float32, device=self.simulator.device)
            caustic = self.simulator(heights)
            return self.measurement.discrepancy(caustic if self._blur is None else blurred(caustic, self._blur))


def is_explained(left: float | None) -> bool:
    """Whether a discrepancy is nothing but noise; False if the noise is unknown."""
    return left is not None and left < LARGEST_OF_NOISE
