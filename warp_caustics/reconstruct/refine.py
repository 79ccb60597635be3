"""``refine``: descent on the exact model, from flat or from any given relief.

Coarse to fine in the image, full resolution in the heights. Two ways down (see
``metric.py``): L-BFGS in the curvature metric for weak caustics from a flat
start, Adam in the height metric for caustics with folds.

Limits: a folded caustic fits several reliefs, and from a flat start descent
finds the wrong one (see docs/refine.md for how wrong). It is meant for weak
reliefs, and for strong ones that start near the truth: the nominal design, or
the result of another method.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

import numpy as np
import scipy.optimize
import torch
from pydantic import BaseModel, ConfigDict, Field

from warp_caustics.energy import energy_budget
from warp_caustics.reconstruct.base import (
    CausticImage,
    FloatArray,
    Progress,
    ProgressCallback,
    Reconstruction,
    Reconstructor,
    StopReason,
)
from warp_caustics.reconstruct.metric import CurvatureMetric
from warp_caustics.reconstruct.objective import DataTerm, Measurement, negativity, total_variation
from warp_caustics.reconstruct.pyramid import check_image, check_initial, level_sizes, measurement_at
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator, usable_device

FOLD_IRRADIANCE = 2.0
"""A caustic whose 99.5 % quantile exceeds this multiple of the radiosity is taken to have folds."""

Metric = Literal["auto", "curvature", "height"]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class RefineOptions(BaseModel):
    """Settings of ``refine``; None means: depends on the metric, see :meth:`resolved`."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    metric: Metric = "auto"
    """auto: height where a start is given or the caustic has folds, else curvature."""
    data_term: DataTerm = "charbonnier"
    charbonnier_width: Annotated[float, Field(gt=0, allow_inf_nan=False)] = 0.05
    """Residual, relative to the radiosity, from which on the data term grows linearly."""
    total_variation: NonNegative | None = None
    """Weight of the mean slope magnitude."""
    nonnegativity: NonNegative | None = None
    """Weight of the mean squared depth below the plate in units of 10 um."""
    bare_fraction: Annotated[float, Field(ge=0, le=1)] | None = None
    """At least this fraction of the plate is bare: its height, the median of the lowest such fraction, is
    zero. 0 leaves the mean height alone."""
    coarsest_pixels: Annotated[int, Field(ge=2)] | None = None
    """Image size of the first pyramid level, at least: n/2 in the curvature metric, n in the height metric
    from flat, 2n from a given relief, which coarser levels would only blur."""
    finest_pixels: Annotated[int, Field(ge=2)] | None = None
    """Image size of the last level: all pixels on a GPU, at most 2n on a CPU."""
    border_pixels: Annotated[int, Field(ge=0, le=16)] = 1
    """Ring of pixels ignored at every level. What happens at the very edge of a plate is not in the model, and
    2e-5 of the light missing there would be explained by a bend of the whole plate by 3 um."""
    max_iterations: Annotated[int, Field(ge=1)] | None = None
    """Iterations per level."""
    step_m: Annotated[float, Field(gt=0, le=1e-3, allow_inf_nan=False)] | None = None
    """First step of Adam [m] (height metric)."""
    max_time_s: Annotated[float, Field(gt=0)] | None = None
    """Stop after this time [s] with the best relief so far."""
    discrepancy: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 1.0
    """Leave a level when the RMS residual falls to this multiple of the noise (Morozov); 0 never does."""

    def resolved(self, metric: Metric, is_flat: bool, scene: Scene, device_type: str) -> "RefineOptions":
        """With every None replaced.

        From flat, priors must be strong: without them folded caustics are fitted by deep trenches. Near the
        truth, weaker ones bias less.
        """
        n = scene.height_samples
        defaults: dict[str, Any] = {"total_variation": 0.03, "nonnegativity": 0.01, "bare_fraction": 0.0}
        defaults |= {"coarsest_pixels": 2 * n, "max_iterations": 300, "step_m": 5e-6}
        if metric == "curvature":
            defaults |= {"total_variation": 0.0, "nonnegativity": 0.0, "bare_fraction": 0.2}
            defaults |= {"coarsest_pixels": max(2, n // 2), "max_iterations": 60}
        elif is_flat:
            defaults |= {"total_variation": 0.1, "nonnegativity": 0.1, "coarsest_pixels": n, "step_m": 1e-5}
        finest = scene.image_pixels
        while device_type == "cpu" and finest > 2 * n and finest % 2 == 0:
            finest //= 2
        defaults["finest_pixels"] = finest
        known = {key: value for key, value in self.model_dump().items() if value is not None}
        return RefineOptions(**(defaults | known | {"metric": metric}))


class _StopLevel(Exception):
    """Ends the present level; carries the reason."""

    def __init__(self, reason: StopReason):
        self.reason = reason


@dataclass
class _Run:
    """Bookkeeping of one reconstruction: what was tried, what was best, when to stop."""

    options: RefineOptions
    total: int
    progress: ProgressCallback | None
    started: float = field(default_factory=time.perf_counter)
    history: list[dict[str, Any]] = field(default_factory=list)
    best: FloatArray | None = None
    best_objective: float = np.inf

    def start_level(self, heights: FloatArray) -> None:
        """Objectives of different levels cannot be compared."""
        self.best, self.best_objective = heights.copy(), np.inf

    def note(self, stage: str, heights: FloatArray, objective: float, residual: float, noise: float | None) -> None:
        """Record an evaluation.

        Raises:
            _StopLevel: the noise is reached, or the time is up.
        """
        elapsed = time.perf_counter() - self.started
        if objective < self.best_objective:
            self.best, self.best_objective = heights.copy(), objective
        entry = {"stage": stage, "iteration": len(self.history) + 1, "objective": objective, "residual": residual}
        self.history.append(entry | {"discrepancy": noise, "elapsed_s": elapsed})
        if self.progress is not None:
            self.progress(Progress(stage, len(self.history), self.total, residual, elapsed))
        if noise is not None and noise <= self.options.discrepancy:
            self.best = heights.copy()
            raise _StopLevel("discrepancy")
        if self.options.max_time_s is not None and elapsed > self.options.max_time_s:
            raise _StopLevel("max_time")


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
        check_image(image, self.scene)
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
        run = _Run(options, options.max_iterations * len(sizes), progress)
        reason: StopReason = "max_iterations"
        try:
            for k, size in enumerate(sizes):
                stage = f"level {k + 1} of {len(sizes)}, {size} x {size} pixels"
                heights, reason = self._level(image, size, heights, stage, run)
                if reason == "max_time":
                    break
        except KeyboardInterrupt:
            heights, reason = heights if run.best is None else run.best, "interrupted"
        descent_s = time.perf_counter() - run.started
        return self._result(image, heights, reason, run, sizes, descent_s)

    def _metric(self, image: CausticImage, is_flat: bool) -> Metric:
        if self.options.metric != "auto":
            return self.options.metric
        radiosity = np.maximum(np.asarray(self.scene.radiosity_W_m2), 1e-30)[:, None, None]
        has_folds = np.quantile(image.irradiance / radiosity, 0.995) > FOLD_IRRADIANCE
        return "curvature" if is_flat and not has_folds else "height"

    def _level(
        self, image: CausticImage, size: int, heights: FloatArray, stage: str, run: _Run
    ) -> tuple[FloatArray, StopReason]:
        """Descend at one image size; returns the best relief and why it ended."""
        # Simulated in units of the radiosity, so that weights mean the same for dim and bright light.
        ones = tuple(float(r > 0) for r in self.scene.radiosity_W_m2)
        scene = self.scene.model_copy(update={"image_pixels": size, "radiosity_W_m2": ones})
        simulator = CausticSimulator(scene, "lattice", device=self.device)
        measurement = measurement_at(image, self.scene, size, self.device, run.options.border_pixels)

        def evaluate(candidate: FloatArray) -> tuple[float, FloatArray]:
            return self._evaluate(simulator, measurement, candidate, stage, run)

        run.start_level(heights)
        descend = _descend_curvature if run.options.metric == "curvature" else _descend_heights
        try:
            reason = descend(evaluate, heights, self.scene, run.options)
        except _StopLevel as stop:
            reason = stop.reason
        assert run.best is not None
        return _anchored(run.best, run.options), reason

    def _evaluate(
        self, simulator: CausticSimulator, measurement: Measurement, heights: FloatArray, stage: str, run: _Run
    ) -> tuple[float, FloatArray]:
        """Objective and its gradient at a relief."""
        options = run.options
        leaf = torch.tensor(heights, dtype=torch.float32, device=self.device, requires_grad=True)
        image = simulator(leaf)
        objective = measurement.data_term(image, options.data_term, options.charbonnier_width)
        if options.total_variation:
            objective = objective + options.total_variation * total_variation(leaf, self.scene.sample_pitch_m)
        if options.nonnegativity:
            objective = objective + options.nonnegativity * negativity(leaf)
        objective.backward()
        assert leaf.grad is not None
        with torch.no_grad():
            residual, noise = measurement.relative_residual(image), measurement.discrepancy(image)
        value = float(objective.detach())
        run.note(stage, heights, value, residual, noise)
        return value, leaf.grad.double().cpu().numpy()

    def _result(
        self,
        image: CausticImage,
        heights: FloatArray,
        reason: StopReason,
        run: _Run,
        sizes: list[int],
        descent_s: float,
    ) -> Reconstruction:
        started = time.perf_counter()
        simulator = CausticSimulator(self.scene, "lattice", device=self.device)
        found = torch.tensor(heights, dtype=torch.float32, device=self.device)
        measurement = measurement_at(image, self.scene, self.scene.image_pixels, self.device)
        radiosity = torch.tensor(self.scene.radiosity_W_m2, device=self.device)[:, None, None]
        with torch.no_grad():
            simulated = simulator(found)
            residual = measurement.relative_residual(simulated / radiosity.clamp_min(1e-30))
        counters = {"evaluations": len(run.history), "energy": energy_budget(simulator, found)}
        settings = run.options.model_dump() | {"levels": sizes, "simulation": simulator.settings()}
        timings = {"descent": descent_s, "resimulation": time.perf_counter() - started}
        warnings = []
        if sizes[-1] < self.scene.image_pixels:
            warnings.append(
                f"image binned to {sizes[-1]} pixels to save time; finest_pixels={self.scene.image_pixels} uses all"
            )
        return Reconstruction(
            method=self.name,
            heights_m=heights,
            image=simulated.cpu().numpy(),
            residual=residual,
            stop_reason=reason,
            history=run.history,
            timings_s=timings,
            counters=counters,
            settings=settings,
            warnings=tuple(warnings),
        )


Evaluate = Callable[[FloatArray], tuple[float, FloatArray]]


def _anchored(heights: FloatArray, options: RefineOptions) -> FloatArray:
    """Heights shifted so that the bare plate is at zero."""
    if not options.bare_fraction:
        return heights
    return heights - np.quantile(heights, options.bare_fraction / 2)


def _descend_curvature(evaluate: Evaluate, heights: FloatArray, scene: Scene, options: RefineOptions) -> StopReason:
    """L-BFGS in the curvature metric, restarted once the mean height has been set right."""
    n = scene.height_samples
    index = float(np.mean(scene.glass_indices))
    metric = CurvatureMetric(n, scene.plate_size_m, (1 - 1 / index) * scene.base_thickness_m)
    start = heights
    lowest = -0.9 * scene.base_thickness_m

    def objective(u: FloatArray) -> tuple[float, FloatArray]:
        candidate = start + metric.apply(u.reshape(n, n))
        if candidate.min() <= lowest:
            # A line search may overshoot through the plate; steer it back.
            return 1e6 * (1 + float(u @ u)), 2e6 * u
        value, gradient = evaluate(candidate)
        # Means become sums: L-BFGS-B's tolerances are absolute.
        return value * n**2, metric.apply(gradient).ravel() * n**2

    assert options.max_iterations is not None
    converged = False
    for share in (0.5, 0.5):
        iterations = max(1, int(share * options.max_iterations))
        settings = {"maxiter": iterations, "maxfun": iterations, "maxcor": 20, "ftol": 1e-9, "gtol": 1e-12}
        result = scipy.optimize.minimize(objective, np.zeros(n * n), jac=True, method="L-BFGS-B", options=settings)
        start = _anchored(start + metric.apply(result.x.reshape(n, n)), options)
        converged = result.status == 0
    return "converged" if converged else "max_iterations"


def _descend_heights(evaluate: Evaluate, heights: FloatArray, scene: Scene, options: RefineOptions) -> StopReason:
    """Adam on the heights, step falling to a twentieth along a cosine."""
    assert options.max_iterations is not None
    assert options.step_m is not None
    variable = torch.tensor(heights)
    adam = torch.optim.Adam([variable], lr=options.step_m)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(adam, options.max_iterations, eta_min=options.step_m / 20)
    for _ in range(options.max_iterations):
        _, gradient = evaluate(variable.numpy())
        variable.grad = torch.from_numpy(gradient)
        adam.step()
        schedule.step()
        variable.clamp_(min=-0.9 * scene.base_thickness_m)
    return "max_iterations"
