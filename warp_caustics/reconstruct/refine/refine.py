"""``refine``: descent on the exact model, from flat or from any given relief.

Coarse to fine in the image, full resolution in the heights. Two ways down (see
``metric.py``): L-BFGS in the curvature metric for weak caustics from a flat
start, Adam in the height metric for caustics with folds.

Limits: a folded caustic fits several reliefs, and from a flat start descent
finds the wrong one (see docs/refine.md for how wrong). It is meant for weak
reliefs, and for strong ones that start near the truth: the nominal design, or
the result of another method.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch

from warp_caustics.reconstruct.base import CausticImage, ProgressCallback, Reconstruction, Reconstructor, StopReason
from warp_caustics.reconstruct.exposure import (
    LEAST_EXPOSURE_ERROR,
    MOST_LIGHT_LOST,
    agreed_ratio,
    at_nominal,
    exposure_warning,
    is_exposure,
    light_ratio,
)
from warp_caustics.reconstruct.folds import has_folds
from warp_caustics.reconstruct.objective import Evaluation, Measurement
from warp_caustics.reconstruct.pyramid import check_image, check_initial, level_sizes, measurement_at, simulator_at
from warp_caustics.reconstruct.refine.curvature_descent import CurvatureDescent, anchored
from warp_caustics.reconstruct.refine.height_descent import HeightDescent
from warp_caustics.reconstruct.refine.options import Metric, RefineOptions
from warp_caustics.reconstruct.refine.relief_objective import ReliefObjective
from warp_caustics.reconstruct.result import Resimulation, make_result
from warp_caustics.reconstruct.run_log import RunLog, note_evaluation, why_stopped
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator, usable_device
from warp_caustics.types import FloatArray

Note = Callable[[Evaluation], None]
_MAX_ITERATIONS: StopReason = "max_iterations"


@dataclass(frozen=True, eq=False)
class Descended:
    """Where a descent ended.

    Attributes:
        heights_m: the best relief [m], shape [n, n].
        reason: why it ended.
        options: as they were resolved.
        log: of its evaluations.
        sizes: pixels per side of each level.
        exposure: by which the image was divided, shape [n_w]; None if by nothing.
    """

    heights_m: FloatArray
    reason: StopReason
    options: RefineOptions
    log: RunLog
    sizes: list[int]
    exposure: FloatArray | None


class Refine(Reconstructor):
    """Descent on the exact model.

    Args:
        scene: the set-up of the measurement.
        options: see :class:`RefineOptions`.
        device: where to simulate.
    """

    name = "refine"

    def __init__(self, scene: Scene, options: RefineOptions | None = None, device: str | torch.device = "cpu"):
        self.scene, self.options, self.device = scene, options or RefineOptions(), usable_device(device)
        self._descents: dict[tuple[int, RefineOptions], HeightDescent] = {}

    def reconstruct(
        self,
        image: CausticImage,
        *,
        initial: FloatArray | None = None,
        progress: ProgressCallback | None = None,
    ) -> Reconstruction:
        """Recover the relief; see :class:`~warp_caustics.reconstruct.base.Reconstructor`.

        Ctrl-C (KeyboardInterrupt) ends it with the best relief so far.
        """
        image = check_image(image, self.scene)
        return self._result(image, self.descended(image, initial=initial, progress=progress))

    def descended(
        self, image: CausticImage, *, initial: FloatArray | None = None, progress: ProgressCallback | None = None
    ) -> Descended:
        """What :meth:`reconstruct` finds, without a judgement of it; arguments likewise, the image checked."""
        if initial is not None:
            check_initial(initial, self.scene)
        n = self.scene.height_samples
        heights: FloatArray = np.zeros((n, n)) if initial is None else initial.astype(np.float64)
        is_flat = initial is None or not np.ptp(initial)
        options = self.options.resolved(self._metric(image, is_flat), is_flat, self.scene, self.device.type)
        assert options.finest_pixels is not None
        assert options.max_iterations is not None
        assert options.coarsest_pixels is not None
        coarsest = min(options.coarsest_pixels, options.finest_pixels)
        sizes = level_sizes(self.scene.image_pixels, coarsest, options.finest_pixels)
        log = RunLog(options.max_iterations * len(sizes), progress, options.max_time_s, options.discrepancy)
        exposure = self._exposure(image, None if is_flat else heights, options)
        nominal = image if exposure is None else at_nominal(image, exposure)
        reason: StopReason = "max_iterations"
        for k, size in enumerate(sizes):
            stage = f"level {k + 1} of {len(sizes)}, {size} x {size} pixels"
            descend = self._descend_curvature if options.metric == "curvature" else self._descend_heights
            measurement = measurement_at(nominal, self.scene, size, self.device, options.border_pixels)
            heights, reason = descend(measurement, size, heights, options, partial(note_evaluation, log, stage))
            if reason in ("max_time", "interrupted"):
                break
        return Descended(heights, reason, options, log, sizes, exposure)

    def _exposure(self, image: CausticImage, start: FloatArray | None, options: RefineOptions) -> FloatArray | None:
        """By which to divide the image, shape [n_w]; None if by nothing.

        Told by the start, else by a flat plate: exactly for a weak relief; one with folds may lose some light.
        """
        if options.exposure == "trust":
            return None
        measurement = measurement_at(image, self.scene, self.scene.image_pixels, self.device)
        ratio, noticed = light_ratio(measurement), LEAST_EXPOSURE_ERROR
        if start is not None:
            simulator = simulator_at(self.scene, self.scene.image_pixels, self.device)
            with torch.no_grad():
                simulated = simulator(torch.tensor(start, dtype=torch.float32, device=self.device))
            ratio = agreed_ratio(light_ratio(measurement, simulated), ratio)
        elif options.metric == "height":
            noticed = MOST_LIGHT_LOST
        return ratio if is_exposure(ratio, noticed) else None

    def _metric(self, image: CausticImage, is_flat: bool) -> Metric:
        if self.options.metric != "auto":
            return self.options.metric
        return "curvature" if is_flat and not has_folds(image, self.scene) else "height"

    def _descend_heights(
        self, measurement: Measurement, size: int, heights: FloatArray, options: RefineOptions, note: Note
    ) -> tuple[FloatArray, StopReason]:
        """Adam on the heights at one image size; the best relief and why it ended."""
        key = size, options
        if key not in self._descents:
            self._descents[key] = HeightDescent(simulator_at(self.scene, size, self.device), options)
        descent, reason = self._descents[key], _MAX_ITERATIONS
        try:
            descent.run(measurement, heights, note)
        except KeyboardInterrupt as stop:
            reason = why_stopped(stop)
        return anchored(descent.best_heights(), options), reason

    def _descend_curvature(
        self, measurement: Measurement, size: int, heights: FloatArray, options: RefineOptions, note: Note
    ) -> tuple[FloatArray, StopReason]:
        """L-BFGS in the curvature metric at one image size; the best relief and why it ended."""
        objective = ReliefObjective(simulator_at(self.scene, size, self.device), measurement, options)
        descent = CurvatureDescent(objective, self.scene, options, note)
        reason: StopReason
        try:
            reason = descent.run(heights)
        except KeyboardInterrupt as stop:
            reason = why_stopped(stop)
        return anchored(descent.best, options), reason

    def _result(
        self,
        image: CausticImage,
        found: Descended,
    ) -> Reconstruction:
        descent_s, sizes = found.log.elapsed_s, found.sizes
        simulator = CausticSimulator(self.scene, "lattice", device=self.device)
        resimulation = Resimulation(simulator, image, found.exposure)
        warnings = []
        if sizes[-1] < self.scene.image_pixels:
            warnings.append(
                f"image binned to {sizes[-1]} pixels to save time; "
                f"--set reconstruction.options.finest_pixels={self.scene.image_pixels} uses all"
            )
        told = exposure_warning(resimulation.exposure, LEAST_EXPOSURE_ERROR)
        if told is not None:
            warnings.append(f"{told}; --set reconstruction.options.exposure=trust explains it by the relief")
        return make_result(
            self.name,
            resimulation,
            found.heights_m,
            reason=found.reason,
            history=found.log.history,
            timings={"descent": descent_s},
            counters={"evaluations": len(found.log.history), "exposure": resimulation.exposure.tolist()},
            settings=found.options.model_dump() | {"levels": sizes},
            warnings=warnings,
            found_at=sizes[-1],
        )
