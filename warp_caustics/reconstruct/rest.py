"""What a result leaves of the image beyond its noise: how much, where, and how fine."""

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import scipy  # loads its parts when they are first used
import torch

from warp_caustics.reconstruct.objective import Measurement
from warp_caustics.reconstruct.trust import Seen
from warp_caustics.types import FloatArray

EVEN = 0.15
"""Of a flat plate's light: where a result shows no more than this besides, and nothing bright is near, it is even."""
NEAR_PX = 7
"""Pixels that are near, along a side."""
BRIGHT = 1.5
"""Of a flat plate's light, from which on it is bright: lines of caustics."""
COARSE_PX = 8.0
"""Standard deviation of what is averaged over to tell the coarse from the fine [px]."""


@dataclass(frozen=True, eq=False)
class Rest:
    """What is left of an image at the pixels where heights were found, in units of the radiosity.

    Attributes:
        measurement: the image, with its noise.
        shown: by the result, as the camera sees it, shape [n_w, m, m].
        left: measured minus shown; 0 where pixels do not count.
        noise2: variance of the noise there.
        simulation2: square of what two simulations differ by.
    """

    measurement: Measurement
    shown: torch.Tensor
    left: torch.Tensor
    noise2: torch.Tensor
    simulation2: torch.Tensor

    @classmethod
    def of(cls, measurement: Measurement, seen: Seen) -> "Rest":
        """Of an image whose noise is known."""
        assert measurement.noise is not None
        weight = measurement.weight.double()
        shown = seen.image.double()
        return cls(
            measurement,
            shown,
            (measurement.irradiance.double() - shown) * weight,
            measurement.noise.double() ** 2 * weight,
            (seen.image - seen.by_half).double() ** 2 * weight,
        )

    @property
    def light2(self) -> float:
        """Of the image, sum of squares."""
        return float((self.measurement.irradiance.double() * self.measurement.weight).square().sum())

    @property
    def beyond2(self) -> float:
        """Sum of squares beyond the noise, at least 0."""
        return max(float((self.left.square() - self.noise2).sum()), 0.0)

    @property
    def variance(self) -> torch.Tensor:
        """Of each pixel by which it is weighed: noise, both simulations' and a hundredth of the light."""
        return self.noise2 + self.simulation2 / 2 + (0.01 * self.shown) ** 2 + 1e-6

    def by_region(self) -> dict[str, float]:
        """Shares of what is left beyond noise, of the image's light, by where it is; roots, so that their squares add.

        ``even``: next to nothing is shown there; ``bright``: lines; ``between``: the rest. ``coarse``: of all of it
        what is left after means over :data:`COARSE_PX`.
        """
        even, bright = self.regions()
        beyond = (self.left.square() - self.noise2).sum(0)
        parts = {"even": even, "bright": bright & ~even, "between": ~(even | bright)}
        found = {name: _share(float(beyond[where].sum()), self.light2) for name, where in parts.items()}
        return found | {"coarse": _share(float(self.coarse.square().sum()), self.light2)}

    @cached_property
    def coarse(self) -> torch.Tensor:
        """What is left of :attr:`left` after means over :data:`COARSE_PX`, shape [n_w, m, m]."""
        if self.left.is_cuda:
            means = coarse_means(self.left.shape[-1]).to(self.left.device)
            return means @ self.left @ means.T
        return torch.from_numpy(scipy.ndimage.gaussian_filter(self.left.numpy(), (0, COARSE_PX, COARSE_PX)))

    def regions(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Where light is even and where it is bright, shape [m, m] each."""
        apart = (self.shown - 1).abs().amax(0)[None, None]
        even = torch.nn.functional.max_pool2d(apart, NEAR_PX, 1, NEAR_PX // 2)[0, 0] < EVEN
        return even, self.shown.amax(0) > BRIGHT

    @property
    def share(self) -> float:
        """Of the image's contrast, what is left beyond noise and simulation."""
        contrast = ((1 - self.measurement.irradiance.double()) * self.measurement.weight).square()
        beyond = self.left.square() - self.noise2 - self.simulation2
        return _share(float(beyond.sum()), float(contrast.sum()))

    def record(self) -> dict[str, Any]:
        """For a result's counters: shares of the image's light."""
        return {"beyond_noise": _share(self.beyond2, self.light2), "of_contrast": self.share, **self.by_region()}


@lru_cache(maxsize=4)
def coarse_means(pixels: int) -> torch.Tensor:
    """Means over :data:`COARSE_PX` along one axis as a matrix, shape [pixels, pixels], float64."""
    return torch.from_numpy(scipy.ndimage.gaussian_filter1d(np.eye(pixels), COARSE_PX, axis=0))


def local_relief(heights: FloatArray) -> FloatArray:
    """Height of the relief around each sample [m]: of the highest of its neighbours, smoothed."""
    largest = scipy.ndimage.maximum_filter(np.abs(heights), 3)
    return np.asarray(scipy.ndimage.gaussian_filter(largest, 1.5))


def _share(part: float, whole: float) -> float:
    return math.sqrt(max(part, 0.0) / whole) if whole > 0 else 0.0
