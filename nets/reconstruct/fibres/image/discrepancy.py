"""Discrepancy of a relief: what it leaves of the image, in units of the image's noise.

By Morozov's discrepancy principle a relief explains an image as soon as it leaves no more than noise; to fit the image
any better would be to fit the noise (Engl, Hanke & Neubauer, Regularization of Inverse Problems, section 4.3).

It is asked of the pixels whose light the relief has moved. Even light behind bare plate is explained by any relief;
where it is most of the image it hides what lines get wrong: three lines under a lamp at 1 m that is told as parallel
left 1.09 times the noise of a whole image, 2.2 times that where light was moved, and were 3.9 um wrong.
"""

import dataclasses
from functools import partial

import numpy as np
import torch

from nets.reconstruct.fibres.image.image_fit import BORDER_PIXELS, FINE_PHOTONS_PER_PIXEL
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.image_noise import with_grain
from warp_caustics.reconstruct.pyramid import measurement_at, simulator_at
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.reconstruct.seen_camera.exact_picture import ExactPicture
from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray

LARGEST_OF_NOISE = 1.7
"""Discrepancy below which nothing but noise is left: 1.5 of a whole image, two thirds of which prints of Tab. 3 move.
Of whole images the true reliefs of six own plates have 1.00 to 1.23, those found before the last descent 1.1 to 3.3;
where light was moved, those of six others 0.94 to 0.98. With a lattice of four photons per pixel the truth itself has
up to 2.2."""

FAR_OF_NOISE = 5.0
"""Discrepancy of a whole image above which a descent on all pixels does not bring lines down to noise: 1.1 to 3.3 came
down to it."""

LATTICE_ERROR = 0.01
"""Error of a simulation with ``FINE_PHOTONS_PER_PIXEL``, relative to the irradiance: four own plates without noise have
0.15 to 1.1 % RMS, those with most folds the most. An image without noise is explained when no more than it is left."""

SMOOTHED_PX = 2
"""Light has been moved where the mean over so many pixels to each side is off by one pixel's noise, five of its own."""
MARGIN_PX = 4
"""Around such pixels, that count as well."""

PLACE = 1 / 32
"""Of the width of an image, in which what is left is looked at together."""
REACHED_SAMPLES = 2
"""How far light lands from the sample of the relief that sent it."""
LEAST_CONTRAST = 0.01
"""Relative to even light, so that what is left in even light is no large share of nothing."""


class Discrepancy:
    """RMS of simulated minus measured where light has been moved.

    In units of the measurement's noise or the simulation's error, the larger one.

    Args:
        scene: the set-up.
        image: what was measured.
        device: where to simulate.
        camera: that took it, whose channels lie together; None for a perfect one.
    """

    def __init__(
        self, scene: Scene, image: CausticImage, device: str | torch.device, camera: ChannelCamera | None = None
    ):
        self.simulator = simulator_at(scene, scene.image_pixels, device, FINE_PHOTONS_PER_PIXEL)
        camera = camera or ChannelCamera.perfect(scene.n_wavelengths, scene.image_pixels)
        self._picture = ExactPicture(self.simulator, camera)
        self._known: tuple[FloatArray, torch.Tensor] | None = None
        self.samples = scene.height_samples
        plain = measurement_at(image, scene, scene.image_pixels, self.simulator.device, BORDER_PIXELS)
        plain = with_grain(plain, image, scene)
        noise = plain.noise
        if noise is not None:
            noise = torch.maximum(noise, LATTICE_ERROR * plain.irradiance.double())
        self.whole = dataclasses.replace(plain, noise=noise)
        weight = plain.weight
        if noise is not None:
            weight = weight * moved_light(plain.irradiance, weight, noise)
        self.measurement = dataclasses.replace(self.whole, weight=weight)

    def __call__(self, heights_m: FloatArray) -> float | None:
        """Of a relief [m], shape [n, n]; None if the noise of the image is unknown."""
        return self.measurement.discrepancy(self.picture(heights_m))

    def of_all(self, heights_m: FloatArray) -> float | None:
        """The same of the whole image, even light and all."""
        return self.whole.discrepancy(self.picture(heights_m))

    def places(self, heights_m: FloatArray) -> FloatArray:
        """Share of the image's contrast that is left around each sample of a relief, shape [n, n]; 0 where it is noise.

        Root mean squares over squares of ``PLACE`` of the plate's width, the largest that light of a sample may reach.
        Left is what exceeds ``LARGEST_OF_NOISE`` times the noise; contrast is the difference from most of the image.

        Raises:
            ValueError: the noise of the image is unknown.
        """
        seen = self.whole
        if seen.noise is None:
            raise ValueError("what is left of an image beyond its noise needs the noise; tell it")
        weight, light = seen.weight.double(), seen.irradiance.double()
        left = (self.picture(heights_m).double() - light).square() - (LARGEST_OF_NOISE * seen.noise.double()).square()
        even = [values[on > 0].median() if (on > 0).any() else 0.0 for values, on in zip(light, weight, strict=True)]
        contrast = (light - torch.as_tensor(even, dtype=light.dtype, device=light.device)[:, None, None]).square()
        radius = max(1, round(PLACE * light.shape[-1] / 2))

        def mean(values: torch.Tensor) -> torch.Tensor:
            counted = (weight * values).sum(0)[None, None]
            return torch.nn.functional.avg_pool2d(counted, 2 * radius + 1, stride=1, padding=radius)[0]

        whole = torch.maximum(mean(contrast), LEAST_CONTRAST**2 * mean(torch.ones_like(light)))
        share = (mean(left) / whole.clamp_min(1e-12)).clamp(0, 1).sqrt()
        reached = 2 * REACHED_SAMPLES + 1
        at_samples = torch.nn.functional.adaptive_max_pool2d(share, self.samples)
        spread = torch.nn.functional.max_pool2d(at_samples, reached, stride=1, padding=REACHED_SAMPLES)
        return np.asarray(spread[0].cpu().numpy())

    def picture(self, heights_m: FloatArray) -> torch.Tensor:
        """What the camera shows of a relief [m], shape [n, n], in units of the radiosity, shape [n_w, m, m].

        Kept, since several questions are asked of one relief.
        """
        if self._known is None or not np.array_equal(self._known[0], heights_m):
            seen = self._picture(torch.tensor(heights_m, dtype=torch.float32, device=self.simulator.device))
            self._known = np.array(heights_m), seen
        return self._known[1]


def moved_light(irradiance: torch.Tensor, weight: torch.Tensor, noise: torch.Tensor) -> torch.Tensor:
    """Where an image is not as bright as most of it, 1 or 0, shape [m, m]; 1 everywhere if it nowhere is.

    Most of an image is even light where prints are few. Where they are many, or the lamp's light is uneven, nearly all
    of it counts.

    Args:
        irradiance: shape [n_w, m, m].
        weight: 1 where a pixel counts, same shape.
        noise: standard deviation of each pixel, same shape.
    """
    window, margin = 2 * SMOOTHED_PX + 1, 2 * MARGIN_PX + 1
    smooth = partial(torch.nn.functional.avg_pool2d, kernel_size=window, stride=1, padding=SMOOTHED_PX)
    counted = smooth(weight[None])[0]
    mean = smooth((irradiance * weight)[None])[0] / counted.clamp_min(1e-6)
    differs = torch.zeros(irradiance.shape[-2:], dtype=torch.bool, device=irradiance.device)
    for channel, values, sigma in zip(mean, irradiance, noise, strict=True):
        seen = weight.amin(0) > 0
        if seen.any():
            differs |= seen & ((channel - values[seen].median()).abs() > sigma[seen].median())
    if not differs.any():
        return torch.ones_like(irradiance[0])
    return torch.nn.functional.max_pool2d(differs.float()[None, None], margin, stride=1, padding=MARGIN_PX)[0, 0]


def is_explained(left: float | None) -> bool:
    """Whether a discrepancy is nothing but noise; False if the noise is unknown."""
    return left is not None and left < LARGEST_OF_NOISE
