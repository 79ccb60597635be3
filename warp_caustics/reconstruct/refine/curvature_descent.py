"""L-BFGS in the curvature metric: weak caustics from a flat start, see ``metric.py``.

Liu and Nocedal 1989; SciPy runs the form with bounds (Byrd et al. 1995), which are not used.
"""

from collections.abc import Callable

import numpy as np
import scipy  # loads its parts when they are first used
import torch

from warp_caustics.data_gradient import lowest_height_m
from warp_caustics.reconstruct.base import StopReason
from warp_caustics.reconstruct.objective import Evaluation
from warp_caustics.reconstruct.refine.metric import CurvatureMetric
from warp_caustics.reconstruct.refine.options import RefineOptions
from warp_caustics.reconstruct.refine.relief_objective import ReliefObjective
from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray


def anchored(heights: FloatArray, options: RefineOptions) -> FloatArray:
    """Heights shifted so that the bare plate is at zero."""
    if not options.bare_fraction:
        return heights
    return heights - np.quantile(heights, options.bare_fraction / 2)


class CurvatureDescent:
    """Two runs of L-BFGS: restarted once the mean height has been set right.

    Args:
        objective: to minimise.
        scene: gives plate and glass.
        options: resolved.
        note: called after each evaluation; may raise.
    """

    def __init__(
        self,
        objective: ReliefObjective,
        scene: Scene,
        options: RefineOptions,
        note: Callable[[Evaluation], None],
    ):
        self.objective, self.options, self.note = objective, options, note
        self.lowest = lowest_height_m(scene)
        index = float(np.mean(scene.glass_indices))
        strength_m = (1 - 1 / index) * scene.base_thickness_m
        self.metric = CurvatureMetric(scene.height_samples, scene.plate_size_m, strength_m)
        self.best: FloatArray = np.zeros(0)
        """The relief of the lowest objective so far, or the first that leaves only noise [m], shape [n, n]."""
        self.best_objective = np.inf

    def run(self, heights: FloatArray) -> StopReason:
        """Descend from heights [m], shape [n, n]; the result is :attr:`best`."""
        assert self.options.max_iterations is not None
        start, shape = heights, heights.shape
        self.best, self.best_objective = heights.copy(), np.inf
        converged = False
        for share in (0.5, 0.5):
            iterations = max(1, int(share * self.options.max_iterations))
            settings = {"maxiter": iterations, "maxfun": iterations, "maxcor": 20, "ftol": 1e-9, "gtol": 1e-12}

            def objective(u: FloatArray, start: FloatArray = start) -> tuple[float, FloatArray]:
                candidate = start + self.metric.apply(u.reshape(shape))
                if candidate.min() <= self.lowest:
                    # A line search may overshoot through the plate; steer it back.
                    return 1e6 * (1 + float(u @ u)), 2e6 * u
                value, gradient = self._evaluate(candidate)
                # Means become sums: L-BFGS-B's tolerances are absolute.
                return value * heights.size, self.metric.apply(gradient).ravel() * heights.size

            result = scipy.optimize.minimize(
                objective, np.zeros(heights.size), jac=True, method="L-BFGS-B", options=settings
            )
            start = anchored(start + self.metric.apply(result.x.reshape(shape)), self.options)
            # 2 is a search along a line that found nothing lower: the objective is at the rounding of float32.
            converged = result.status in (0, 2)
        return "converged" if converged else "max_iterations"

    def _evaluate(self, heights: FloatArray) -> tuple[float, FloatArray]:
        """Objective and gradient [1/m] at a relief."""
        at = self.objective(torch.as_tensor(heights, dtype=torch.float64, device=self.objective.simulator.device))
        found = Evaluation.read(at.values.tolist())
        only_noise = found.noise is not None and found.noise <= self.options.discrepancy
        if only_noise or found.objective < self.best_objective:
            self.best = heights.copy()
            self.best_objective = min(self.best_objective, found.objective)
        self.note(found)
        gradient: FloatArray = at.gradient.cpu().numpy()
        return found.objective, gradient
