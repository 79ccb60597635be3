"""How strong an image's noise is: what pixels have by themselves, shot noise, and grain that grows with the light."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import NamedTuple, Self

import numpy as np
import torch

from warp_caustics.io.grain import estimate_grain
from warp_caustics.io.noise import estimate_noise_std
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.colour_filters import of_one_filter
from warp_caustics.reconstruct.objective import Measurement
from warp_caustics.reconstruct.pyramid import DARK_FLOOR
from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray

SHARED_PX = 2.0
"""Pixels along which grain is the same, about: means over fewer have as much of it."""


def estimated_noise(image: CausticImage, scene: Scene) -> FloatArray | None:
    """Noise of an image where its irradiance is about the radiosity [W/m^2], shape [n_w]; None where it cannot be told.

    Dark wavelengths, which do not count, have that of the others.
    """
    found = np.full(scene.n_wavelengths, np.nan)
    for channel, level in enumerate(scene.radiosity_W_m2):
        if level > 0:
            valid = None if image.mask is None else np.asarray(image.mask[channel], bool)
            values = np.asarray(image.irradiance[channel], np.float64)
            if image.is_mosaic and image.own is not None:  # means of neighbours have less noise
                measured = of_one_filter(image.own[channel])
                valid, values = None if valid is None else valid[measured], values[measured]
            # At least what 32-bit floats resolve: an image without noise has some.
            found[channel] = max(estimate_noise_std(values, level, valid), 1e-6 * level)
    shines = np.asarray(scene.radiosity_W_m2) > 0
    if not np.isfinite(found[shines]).all():
        return None
    return np.where(shines, found, found[shines].mean())


def estimated_grain(image: CausticImage, scene: Scene) -> FloatArray:
    """Of each channel, relative to the light, shape [n_w]; 0 where there is none, or nothing tells.

    Args:
        image: with the noise that neighbouring pixels do not share.
        scene: of the measurement.
    """
    if image.noise_std is None:
        return np.zeros(scene.n_wavelengths)
    noise = np.asarray(image.noise_std, np.float64)

    def of_channel(channel: int) -> float:
        level = scene.radiosity_W_m2[channel]
        values = np.asarray(image.irradiance[channel], np.float64)
        valid = None if image.mask is None else np.asarray(image.mask[channel], bool)
        if image.is_mosaic and image.own is not None:  # what was made up shares noise with its neighbours
            measured = of_one_filter(image.own[channel])
            valid, values = None if valid is None else valid[measured], values[measured]
        is_told = level > 0 and np.isfinite(noise[channel])
        return estimate_grain(values, level, float(noise[channel]), valid) if is_told else 0.0

    with ThreadPoolExecutor(scene.n_wavelengths) as pool:  # filters of images let other threads run
        return np.array(list(pool.map(of_channel, range(scene.n_wavelengths))))


class NoiseOfLight(NamedTuple):
    """How strong noise is by the light that a pixel gets, not by what was measured there.

    The noise of what was measured has the noise in it: pixels that are too bright by chance count less, and where
    neighbours share their noise and its spectrum is divided out, that makes the light of a bench 1.8 % too dark, in
    grain of 2 %.

    Attributes:
        own: standard deviation of noise that pixels do not share, in light of the radiosity, relative to it, shape
            [n_w, 1, 1].
        grain: the same of noise that grows with the light, same shape.
    """

    own: torch.Tensor
    grain: torch.Tensor

    @classmethod
    def of(cls, image: CausticImage, scene: Scene, device: torch.device) -> Self:
        """Of an image whose noise is known."""
        level = np.where(np.asarray(scene.radiosity_W_m2) > 0, scene.radiosity_W_m2, 1.0)
        parts = np.asarray(image.noise_std, np.float64) / level, estimated_grain(image, scene)
        return cls(*(torch.as_tensor(each, device=device)[:, None, None] for each in parts))

    def __call__(self, light: torch.Tensor) -> torch.Tensor:
        """Standard deviation of each pixel; light and it in units of the radiosity, shape [n_w, m, m]."""
        seen = light.clamp_min(DARK_FLOOR)
        return torch.hypot(self.own * seen.sqrt(), self.grain * seen)


def with_grain(measurement: Measurement, image: CausticImage, scene: Scene) -> Measurement:
    """A measurement whose noise holds the image's grain; as it is where its noise is not known.

    Args:
        measurement: of the image, of all pixels or of means over more than one.
        image: its noise is that of the measurement.
        scene: of the measurement.
    """
    grain = estimated_grain(image, scene)
    if measurement.noise is None or not grain.any():
        return measurement
    factor = image.irradiance.shape[-1] // measurement.irradiance.shape[-1]
    relative = torch.as_tensor(grain * min(1.0, SHARED_PX / factor), device=measurement.noise.device)
    own = relative[:, None, None] * measurement.irradiance.double()
    return replace(measurement, noise=torch.hypot(measurement.noise.double(), own))
