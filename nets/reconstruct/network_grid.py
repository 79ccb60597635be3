"""Between a user's grid and a network's: the picture that the network sees, and heights where the user wants them."""

import dataclasses
from functools import cached_property

import numpy as np
import torch

from nets.encoding import flat_irradiance
from nets.reconstruct.network_io import network_image
from nets.seen_scene import SeenScene
from nets.shipped import FoundNetwork
from warp_caustics.reconstruct.base import CausticImage, Reconstruction
from warp_caustics.reconstruct.seen_camera.aligned_channels import repaired
from warp_caustics.resampling import regridded, regridding_matrix
from warp_caustics.types import FloatArray


class NetworkGrid:
    """Change of grid, plate and channels for one scene and network.

    Pictures are means over pixels and heights means over cells, before and after: no light and no glass comes or goes,
    and fewer pixels alias no more than a camera with as many would. Where the grid is the network's own nothing is
    changed, to the bit.

    Args:
        network: with the user's scene as it sees it.
        device: of the network.
    """

    def __init__(self, network: FoundNetwork, device: torch.device):
        self.seen: SeenScene = network.seen
        self.trained, self.device = network.info.scene, device

    def picture(self, image: CausticImage) -> torch.Tensor:
        """What the network sees, shape [n_w, m, m] of its own [W/m^2], float32; see :func:`network_image`."""
        seen = self.seen
        if seen.is_same:
            return network_image(image, seen.user, self.trained, self.device)
        measured = torch.as_tensor(repaired(image), dtype=torch.float32, device=self.device)
        relative = (measured / flat_irradiance(seen.user).to(self.device))[list(seen.channels)]
        if seen.user.image_pixels != self.trained.image_pixels:
            relative = self._pixels @ relative @ self._pixels.T
        return relative * flat_irradiance(self.trained).to(self.device)

    @cached_property
    def _pixels(self) -> torch.Tensor:
        """From the user's pixels to the network's, along one axis; it takes a while to make."""
        matrix = regridding_matrix(self.seen.user.image_pixels, self.trained.image_pixels)
        return matrix.to(self.device, torch.float32)

    def noise(self, image: CausticImage) -> float | None:
        """Noise of that picture relative to the light of a flat plate; None where the image does not bring it.

        Of as many pixels as are binned into one; splines leave what they are made of.
        """
        if image.noise_std is None:
            return None
        seen = self.seen
        shown = [k for k in dict.fromkeys(seen.channels) if seen.user.radiosity_W_m2[k] > 0]
        relative = [float(image.noise_std[k]) / seen.user.radiosity_W_m2[k] for k in shown]
        return sum(relative) / len(relative) * min(1.0, self.trained.image_pixels / seen.user.image_pixels)

    def heights(self, answers: torch.Tensor) -> torch.Tensor:
        """Answers, shape [B, n', n'], as heights of the user's plate where they are refined, shape [B, n, n] [m]."""
        if self.seen.is_same:
            return answers
        return regridded(answers, self.seen.working.height_samples) / self.seen.scale

    def answer(self, heights: torch.Tensor) -> torch.Tensor:
        """Heights where they are refined as the network would answer them: the reverse of :meth:`heights`."""
        if self.seen.is_same:
            return heights
        return regridded(heights * self.seen.scale, self.trained.height_samples)

    def result(self, found: Reconstruction) -> Reconstruction:
        """What was found on the working grid with its heights and their uncertainty on the user's.

        Means over cells, or splines; errors of neighbours are alike, so that a mean is about as uncertain as they are.
        Image, residual and trust are those of the relief that was found.
        """
        samples = self.seen.user.height_samples
        if samples == self.seen.working.height_samples:
            return found

        def changed(values: FloatArray) -> FloatArray:
            return np.asarray(regridded(torch.as_tensor(values), samples).numpy())

        uncertainty = None if found.uncertainty_m is None else changed(found.uncertainty_m).clip(min=0.0)
        return dataclasses.replace(
            found,
            heights_m=changed(found.heights_m),
            uncertainty_m=uncertainty,
            samples_m=None if found.samples_m is None else changed(found.samples_m),
        )
