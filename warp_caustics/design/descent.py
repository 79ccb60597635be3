"""From the start to the picture: descent on the exact model, coarse to fine in the image.

The same parts as ``refine``: pixels binned level by level so that early gradients see far, and
L-BFGS in the curvature metric. Here the metric knows the way below the plate, the mean height is free, and heights
keep their limit at every step (``limits.py``). Nothing is random.
"""

from collections.abc import Callable

import numpy as np
import scipy.optimize
import torch

from warp_caustics.data_gradient import data_gradient
from warp_caustics.design.limits import MARGIN, bounded
from warp_caustics.design.options import DesignOptions
from warp_caustics.design.smoothness import bending_energy, focusing_strength_m
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.objective import Measurement
from warp_caustics.reconstruct.pyramid import level_sizes, measurement_at, usual_pixels
from warp_caustics.reconstruct.refine.metric import CurvatureMetric
from warp_caustics.reconstruct.transport.ray_inversion import LightPath
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator
from warp_caustics.types import FloatArray

MEMORY = 20
"""Past steps that L-BFGS remembers."""

EARLY_SMOOTHNESS = 0.03
"""Least weight of the bending energy on the first image size; it falls in equal ratios to that of the options. A
blurred picture is also made by reliefs whose light crosses, and no later step undoes that; stiff ones keep it apart."""

LEAST_RATIO = 1e-6
"""Stands for a last weight of 0 in those ratios."""

ANY_WAVELENGTH_M = 530e-9
"""Says nothing where indices are given as numbers."""


def design_levels(scene: Scene, options: DesignOptions) -> list[int]:
    """Image sizes of the descent, coarse to fine."""
    finest = options.finest_pixels or usual_pixels(scene)
    return level_sizes(scene.image_pixels, min(options.coarsest_pixels, finest), finest)


def white(scene: Scene, pixels: int) -> Scene:
    """The scene with all wavelengths that shine at radiosity 1, on another number of pixels."""
    shining = tuple(w for w, r in zip(scene.wavelengths_m, scene.radiosity_W_m2, strict=True) if r > 0)
    light = {"wavelengths_m": shining, "radiosity_W_m2": (1.0,) * len(shining)}
    return scene.model_copy(update={**light, "image_pixels": pixels})


def mean_colour(scene: Scene, pixels: int) -> Scene:
    """The scene in light of the wavelengths' mean index and radiosity 1, on another number of pixels."""
    path = LightPath.of_scene(scene)
    indices = {"glass": path.glass, "exit_medium": path.outside}
    light = {"wavelengths_m": (ANY_WAVELENGTH_M,), "radiosity_W_m2": (1.0,)}
    return scene.model_copy(update={**indices, **light, "image_pixels": pixels})


class Descent:
    """Descent of the free heights; see :func:`warp_caustics.design.limits.bounded` for what they become.

    Args:
        target: irradiance in units of the radiosity, shape [m, m].
        start: heights [m], shape [n, n]; scaled to the limit where they exceed it.
        scene: the set-up.
        options: see :class:`~warp_caustics.design.options.DesignOptions`.
        device: where to simulate.
        report: called after every evaluation with a stage and the relative residual. KeyboardInterrupt, from here
            or from Ctrl-C, ends the descent; the best free heights so far stay.
    """

    def __init__(
        self,
        target: FloatArray,
        start: FloatArray,
        scene: Scene,
        options: DesignOptions,
        device: torch.device,
        report: Callable[[str, float], None],
    ):
        self.target, self.scene, self.options, self.device, self.report = target, scene, options, device, report
        self.strength_m = focusing_strength_m(LightPath.of_scene(scene))
        self.metric = CurvatureMetric(scene.height_samples, scene.plate_size_m, self.strength_m)
        # The limit may want the relief as a whole lower or higher.
        self.metric.gain[0, 0] = self.metric.gain[0, 1]
        self.free = fitted_start(start, options.max_height_m)
        self.evaluations = 0

    def run(self) -> bool:
        """Descend on all levels; True if the last one converged."""
        sizes = design_levels(self.scene, self.options)
        weights = level_smoothness(self.options.smoothness, len(sizes))
        is_converged = False
        for k, size in enumerate(sizes):
            is_last = k == len(sizes) - 1
            scene = (white if is_last and self.options.dispersion else mean_colour)(self.scene, size)
            is_converged = self._level(scene, weights[k], f"descent {k + 1} of {len(sizes)}, {size} x {size} pixels")
        return is_converged

    def heights(self) -> FloatArray:
        """The relief so far [m], lowest 0, shape [n, n]."""
        heights = bounded(torch.tensor(self.free), self.options.max_height_m)
        lowest: FloatArray = (heights - heights.min()).numpy()
        return lowest

    def _level(self, scene: Scene, smoothness: float, stage: str) -> bool:
        """Descend at one image size, in the light of a scene; True if it converged."""
        n = scene.height_samples
        grey = mean_colour(scene, len(self.target))
        measurement = measurement_at(CausticImage(self.target[None]), grey, scene.image_pixels, self.device)
        simulator = CausticSimulator(scene, "lattice", device=self.device)
        start, best = self.free, np.inf

        def objective(u: FloatArray) -> tuple[float, FloatArray]:
            nonlocal best
            free = start + self.metric.apply(u.reshape(n, n))
            value, residual, gradient = self._evaluate(simulator, measurement, smoothness, free)
            self.evaluations += 1
            if value < best:
                self.free, best = free, value
            self.report(stage, residual)
            # Means become sums: L-BFGS-B's tolerances are absolute.
            return value * n**2, self.metric.apply(gradient).ravel() * n**2

        most = self.options.max_iterations
        settings = {"maxiter": most, "maxfun": most, "maxcor": MEMORY, "ftol": 1e-9, "gtol": 1e-12}
        result = scipy.optimize.minimize(objective, np.zeros(n * n), jac=True, method="L-BFGS-B", options=settings)
        # 2 is a search along a line that found nothing lower: the objective is at the rounding of float32.
        return bool(result.status in (0, 2))

    def _evaluate(
        self, simulator: CausticSimulator, measurement: Measurement, smoothness: float, free: FloatArray
    ) -> tuple[float, float, FloatArray]:
        """Objective, relative residual, and the objective's gradient at free heights."""

        def objective(image: torch.Tensor, heights: torch.Tensor) -> torch.Tensor:
            bending = bending_energy(heights, self.scene.sample_pitch_m, self.strength_m)
            return measurement.data_term(image, "l2") + smoothness * bending

        def all_colours(image: torch.Tensor) -> torch.Tensor:
            return image.mean(dim=0, keepdim=True)

        leaf = torch.tensor(free, device=self.device, requires_grad=True)
        heights = bounded(leaf, self.options.max_height_m)
        found = data_gradient(simulator, heights, objective, all_colours)
        (gradient,) = torch.autograd.grad(heights, leaf, found.gradient)
        return float(found.value), measurement.relative_residual(found.image), gradient.cpu().numpy()


def level_smoothness(last: float, levels: int) -> list[float]:
    """Weight of the bending energy on every image size, coarse to fine."""
    falling = np.geomspace(max(last, EARLY_SMOOTHNESS), max(last, LEAST_RATIO), levels)
    return [*falling[:-1].tolist(), last]


def fitted_start(heights: FloatArray, max_height_m: float) -> FloatArray:
    """Heights as free heights: above the compressed margin, and scaled down to what fits between the margins.

    A transport's relief scaled by a half moves all light half the way: a smooth picture, if not the wanted one.
    """
    low = MARGIN * max_height_m
    room, extent = max_height_m - 2 * low, float(np.ptp(heights))
    scale = min(1.0, room / extent) if extent > 0 else 1.0
    fitted: FloatArray = low + (heights - heights.min()) * scale
    return fitted
