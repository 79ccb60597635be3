"""What lines are compared with: an image on one bench, through the camera that took it."""

import dataclasses
from functools import cached_property

import numpy as np
import torch

from nets.reconstruct.fibres.image.discrepancy import FAR_OF_NOISE, Discrepancy, is_explained
from warp_caustics.prints.model import LineModel
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.image_noise import estimated_noise
from warp_caustics.reconstruct.result import Resimulation, as_glass
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray

NOISE = 0.015
"""Standard deviation of a pixel where nobody told it, in units of the radiosity."""
WRONG_SHARE = 0.25
"""Of the contrast of the image in a place (:meth:`Discrepancy.places`) that wrong lines leave there. True reliefs of
twelve own plates, and lines 0.2 and 0.3 um off, leave 0 everywhere; lines 1.3 um off 0.19, nine sets 1.7 to 24 um off
0.39 to 1, though five of them leave no more than noise in the mean."""


class LinesView:
    """An image, its bench and camera, and what lines leave of it there.

    Args:
        resimulation: of the image on the bench, through its camera.
        model: renders lines.
    """

    def __init__(self, resimulation: Resimulation, model: LineModel):
        self.resimulation, self.model = resimulation.exactly(), model

    @property
    def scene(self) -> Scene:
        """The bench."""
        return self.resimulation.simulator.scene

    @property
    def image(self) -> CausticImage:
        """At an exposure of 1, with its channels together."""
        return self.resimulation.image

    @property
    def camera(self) -> ChannelCamera:
        """That took the image."""
        return self.resimulation.camera

    @property
    def noise(self) -> float:
        """Standard deviation of a pixel, in units of the radiosity; the usual one where nobody told it."""
        if self.image.noise_std is None:
            return NOISE
        return float(np.mean(np.asarray(self.image.noise_std) / np.maximum(self.scene.radiosity_W_m2, 1e-30)))

    @cached_property
    def image_with_noise(self) -> CausticImage:
        """The image, whose noise is estimated where nobody told it; None where it cannot be."""
        if self.image.noise_std is not None:
            return self.image
        return dataclasses.replace(self.image, noise_std=estimated_noise(self.image, self.scene))

    @cached_property
    def discrepancy(self) -> Discrepancy:
        """What is left of the image."""
        return Discrepancy(self.scene, self.image_with_noise, self.resimulation.simulator.device, self.camera)

    def relief(self, lines: torch.Tensor) -> FloatArray:
        """Heights of lines, shape [n, n] [m]."""
        return self.glass(self.model.heights(lines))

    def glass(self, heights: torch.Tensor) -> FloatArray:
        """Heights that a plate can have, shape [n, n] [m]."""
        return as_glass(heights.double().cpu().numpy(), self.scene)

    def left(self, lines: torch.Tensor) -> float | None:
        """Discrepancy of lines in the whole image; None if the noise of the image is unknown.

        This compares what is left on one bench with what is left on another, where other light may count as moved.
        """
        return self.discrepancy.of_all(self.relief(lines))

    def is_explained(self, lines: torch.Tensor) -> bool:
        """Whether lines leave nothing but noise."""
        return self.is_relief_explained(self.relief(lines))

    def is_relief_explained(self, heights_m: FloatArray) -> bool:
        """The same of a relief [m], shape [n, n]."""
        return is_explained(self.discrepancy(heights_m))

    def is_wrong_in_places(self, lines: torch.Tensor) -> bool:
        """Whether lines leave clearly more than noise of the image somewhere, even if nothing but noise in the mean."""
        return self._is_relief_wrong_in_places(self.relief(lines))

    def is_settled(self, lines: torch.Tensor) -> bool:
        """Whether lines leave nothing but noise, in the mean and everywhere."""
        return self.is_explained(lines) and not self.is_wrong_in_places(lines)

    def is_relief_settled(self, heights_m: FloatArray) -> bool:
        """The same of a relief [m], shape [n, n]."""
        return self.is_relief_explained(heights_m) and not self._is_relief_wrong_in_places(heights_m)

    def _is_relief_wrong_in_places(self, heights_m: FloatArray) -> bool:
        if self.discrepancy.whole.noise is None:
            return False
        return float(self.discrepancy.places(heights_m).max()) > WRONG_SHARE

    def is_near(self, lines: torch.Tensor) -> bool:
        """Whether lines are near enough to the plate's that a descent on all pixels may leave nothing but noise."""
        left = self.left(lines)
        return left is None or left <= FAR_OF_NOISE
