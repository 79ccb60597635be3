"""What ``refine`` minimises, with its gradient: data term plus priors, evaluated without waiting for the device."""

import math
from typing import NamedTuple

import torch

from warp_caustics.reconstruct.objective import Measurement, negativity, total_variation
from warp_caustics.reconstruct.refine.options import RefineOptions
from warp_caustics.resampling import blurred
from warp_caustics.simulator import CausticSimulator


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


class ReliefObjective:
    """Data term and priors of one image size.

    Args:
        simulator: in units of the radiosity, at the measurement's pixels.
        measurement: what was seen.
        options: weights.
        blur: of the camera, matrices of shape [n_w, m, m], see :func:`~warp_caustics.resampling.blur_matrices`;
            None for none.
    """

    def __init__(
        self,
        simulator: CausticSimulator,
        measurement: Measurement,
        options: RefineOptions,
        blur: torch.Tensor | None = None,
    ):
        self.simulator, self.measurement, self.options, self.blur = simulator, measurement, options, blur

    def __call__(self, heights: torch.Tensor) -> EvaluationTensors:
        """At a relief above the base [m], shape [n, n], float64, on the device; above the bottom of the plate."""
        measurement, options, engine = self.measurement, self.options, self.simulator.engine
        relief = heights.float()[None].contiguous()
        image = engine.image(relief).requires_grad_()
        leaf = relief[0].clone().requires_grad_()
        with torch.enable_grad():
            seen = image[0] if self.blur is None else blurred(image[0], self.blur)
            objective = measurement.data_term(seen, options.data_term, options.charbonnier_width)
            if options.total_variation:
                slopes = total_variation(leaf, self.simulator.scene.sample_pitch_m)
                objective = objective + options.total_variation * slopes
            if options.nonnegativity:
                objective = objective + options.nonnegativity * negativity(leaf)
            for_image, for_leaf = torch.autograd.grad(objective, (image, leaf), allow_unused=True)
        with torch.no_grad():
            gradient = engine.image_adjoint(relief, for_image.contiguous())[0]
            if for_leaf is not None:
                gradient = gradient + for_leaf
            seen = seen.detach()
            residual = measurement.relative_residual_tensor(seen)
            known = measurement.noise is not None
            noise = measurement.discrepancy_tensor(seen) if known else torch.full_like(residual, math.nan)
        return EvaluationTensors(torch.stack((objective.detach().double(), residual, noise)), gradient.double())
