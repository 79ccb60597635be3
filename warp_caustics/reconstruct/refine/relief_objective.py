"""What ``refine`` minimises, with its gradient: data term plus priors, evaluated without waiting for the device."""

import math
from functools import partial

import torch

from warp_caustics.data_gradient import data_gradient
from warp_caustics.reconstruct.objective import EvaluationTensors, Measurement, negativity, total_variation
from warp_caustics.reconstruct.refine.options import RefineOptions
from warp_caustics.resampling import blurred
from warp_caustics.simulator import CausticSimulator


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
        measurement = self.measurement
        camera = None if self.blur is None else partial(blurred, matrices=self.blur)
        found = data_gradient(self.simulator, heights.float(), self._objective, camera, is_checked=False)
        with torch.no_grad():
            residual = measurement.relative_residual_tensor(found.image)
            known = measurement.noise is not None
            noise = measurement.discrepancy_tensor(found.image) if known else torch.full_like(residual, math.nan)
        return EvaluationTensors(torch.stack((found.value.double(), residual, noise)), found.gradient.double())

    def _objective(self, image: torch.Tensor, heights: torch.Tensor) -> torch.Tensor:
        options = self.options
        objective = self.measurement.data_term(image, options.data_term, options.charbonnier_width)
        if options.total_variation:
            slopes = total_variation(heights, self.simulator.scene.sample_pitch_m)
            objective = objective + options.total_variation * slopes
        if options.nonnegativity:
            objective = objective + options.nonnegativity * negativity(heights)
        return objective
