"""What a reconstruction minimises: image data term plus priors on the relief.

All terms are means, so that their weights hold at every pyramid level.
"""

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import torch

from warp_caustics.reconstruct.charbonnier import charbonnier_sum

DataTerm = Literal["charbonnier", "l2", "sqrt", "l1"]

SQRT_OFFSET = 0.05
"""Irradiance added under the root, relative to the radiosity: bounds the slope in the dark."""

HEIGHT_SCALE_M = 1e-5
"""Negative heights are counted in this unit [m]."""

SLOPE_SCALE = 1e-2
"""Slopes below this count quadratically in the total variation [1]."""


class Evaluation(NamedTuple):
    """What was found at one relief."""

    objective: float
    residual: float
    """Relative."""
    noise: float | None
    """Discrepancy in units of the noise; None if that is unknown."""

    @classmethod
    def read(cls, values: list[float]) -> "Evaluation":
        """From the numbers of :class:`EvaluationTensors`."""
        objective, residual, noise = values
        return cls(objective, residual, None if math.isnan(noise) else noise)


class EvaluationTensors(NamedTuple):
    """The same on the device, with the gradient."""

    values: torch.Tensor
    """Objective, residual, discrepancy (not a number if the noise is unknown), shape [3], float64."""
    gradient: torch.Tensor
    """Of the objective [1/m], shape [n, n], float64."""


@dataclass(frozen=True)
class Measurement:
    """A caustic at one pyramid level.

    Attributes:
        irradiance: in units of the radiosity, shape [n_w, m, m].
        weight: 1 where a pixel counts, 0 where not, same shape.
        noise: standard deviation of each pixel, same shape; None if unknown.
    """

    irradiance: torch.Tensor
    weight: torch.Tensor
    noise: torch.Tensor | None

    def data_term(self, image: torch.Tensor, kind: DataTerm, width: float = 0.0) -> torch.Tensor:
        """Mean misfit of an image; in float64, since float32 sums stall a line search.

        With r = image - measured in units of the radiosity: charbonnier, sqrt(r^2 + width^2) - width (Charbonnier et
        al. 1994), grows linearly, so that bright caustic lines which do not overlap yet do not outweigh all the rest;
        l2, r^2 / 2; l1, |r|; sqrt, l2 of twice the roots, which makes shot noise uniform (Anscombe 1948).
        """
        if kind == "charbonnier":
            total = charbonnier_sum(image, self.irradiance, self.weight, width)
            if total is not None:
                return total / self.weight.sum()
        if kind == "sqrt":
            dark = SQRT_OFFSET
            residual = 2 * ((image + dark).sqrt() - (self.irradiance.clamp_min(0) + dark).sqrt())
        else:
            residual = image - self.irradiance
        residual = residual.double()
        if kind == "charbonnier":
            loss = (residual**2 + width**2).sqrt() - width
        else:
            loss = residual.abs() if kind == "l1" else residual**2 / 2
        return (loss * self.weight).sum() / self.weight.sum()

    def relative_residual(self, image: torch.Tensor) -> float:
        """||image - measured|| / ||measured|| over the pixels that count."""
        return float(self.relative_residual_tensor(image))

    def relative_residual_tensor(self, image: torch.Tensor) -> torch.Tensor:
        """The same on the device, which then need not be waited for; shape []."""
        difference = (image - self.irradiance) * self.weight
        relative: torch.Tensor = difference.double().norm() / (self.irradiance * self.weight).double().norm()
        return relative

    def discrepancy(self, image: torch.Tensor) -> float | None:
        """RMS residual in units of the noise: 1 where a relief explains the image; None without a noise estimate."""
        return None if self.noise is None else float(self.discrepancy_tensor(image))

    def discrepancy_tensor(self, image: torch.Tensor) -> torch.Tensor:
        """The same on the device, shape []; the noise must be known."""
        assert self.noise is not None
        squared = ((image - self.irradiance).double() / self.noise) ** 2 * self.weight
        return (squared.sum() / self.weight.sum()).sqrt()


def total_variation(heights: torch.Tensor, pitch_m: tuple[float, float]) -> torch.Tensor:
    """Mean smoothed slope magnitude [1] of heights [n, n] [m]: favours flat plate between the lines.

    sqrt(|grad h|^2 + s^2) - s (Rudin, Osher and Fatemi 1992, smoothed as by Acar and Vogel 1994), s = 0.01.
    """
    slope_x = heights.diff(dim=1)[:-1] / pitch_m[0]
    slope_y = heights.diff(dim=0)[:, :-1] / pitch_m[1]
    return ((slope_x**2 + slope_y**2 + SLOPE_SCALE**2).sqrt() - SLOPE_SCALE).mean()


def negativity(heights: torch.Tensor) -> torch.Tensor:
    """Mean squared depth below the plate, in units of 10 um: prints add glass, they take none away."""
    return (torch.relu(-heights) / HEIGHT_SCALE_M).square().mean()
