"""``sfc``: Shape from Caustics (Kassubeck, Buergel, Castillo, Stiller, Magnor, WACV 2021), written anew.

Minimise D(h) = mean misfit of the simulated caustic over the heights, by one of three iterations from a flat relief:

* ``baseline``: gradient descent, no prior;
* ``landweber_pixel``: gradient step, soft shrinkage between bounds, mask, volume heuristic;
* ``landweber_wavelet``: gradient step and shrinkage on wavelet coefficients, then the same constraints on the pixels;

until the residual reaches the noise (Morozov) or the iterations are used up.

Departures from the published code: exact gradients (its hit distances carry none), steps and thresholds relative to the
problem, a volume heuristic that cannot change sign, mask and volume as inputs. docs/sfc.md says why and how tuned.
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch

from warp_caustics.energy import energy_budget
from warp_caustics.errors import InputError
from warp_caustics.reconstruct.base import (
    DEEPEST_FRACTION,
    CausticImage,
    Progress,
    ProgressCallback,
    Reconstruction,
    Reconstructor,
    StopReason,
)
from warp_caustics.reconstruct.objective import Measurement, total_variation
from warp_caustics.reconstruct.pyramid import check_image, check_initial, level_sizes, measurement_at
from warp_caustics.reconstruct.sfc.constraints import Knowledge, gather
from warp_caustics.reconstruct.sfc.landweber import (
    PixelUpdate,
    PlainUpdate,
    Update,
    WaveletUpdate,
    curvature,
    data_term,
)
from warp_caustics.reconstruct.sfc.options import SfcOptions
from warp_caustics.reconstruct.sfc.wavelets import WaveletBasis
from warp_caustics.reconstruct.volume import VolumeBand, relief_volume
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator, usable_device
from warp_caustics.types import FloatArray

MAX_RELIEF_M = 0.1
"""Where a diverging baseline is stopped [m]."""

MAX_HALVINGS = 6
"""Of the step in one iteration: the volume heuristic may have to raise the data term, whatever the step."""

GROWTH = 1.2
"""Of the step after an iteration that needed no halving."""

CONVERGED_M = 1e-10
"""An iteration that changes no height by more ends the descent [m]."""


@dataclass(frozen=True)
class _Point:
    """A relief and what the model says about it.

    Attributes:
        heights: [m], shape [n, n].
        objective: data term plus total variation.
        gradient: of the objective [1/m], shape [n, n].
        residual: ||S(h) - I|| / ||I||.
        discrepancy: residual in units of the noise; None if the noise is unknown.
    """

    heights: FloatArray
    objective: float
    gradient: FloatArray
    residual: float
    discrepancy: float | None


@dataclass
class _Run:
    """Bookkeeping: every iteration, and the best one."""

    options: SfcOptions
    progress: ProgressCallback | None
    started: float
    history: list[dict[str, Any]] = field(default_factory=list)
    best: _Point | None = None
    timings: dict[str, float] = field(default_factory=dict)

    def note(self, point: _Point, step: float) -> None:
        elapsed = time.perf_counter() - self.started
        if self.best is None or point.objective < self.best.objective:
            self.best = point
        iteration = len(self.history) + 1
        entry: dict[str, Any] = {"stage": self.options.variant, "iteration": iteration, "residual": point.residual}
        entry |= {"objective": point.objective, "discrepancy": point.discrepancy, "step": step}
        self.history.append(entry | {"elapsed_s": elapsed})
        if self.progress is not None:
            total = self.options.max_iterations
            self.progress(Progress(self.options.variant, iteration, total, point.residual, elapsed))

    def has_reached_noise(self, point: _Point) -> bool:
        """Morozov's discrepancy principle."""
        return point.discrepancy is not None and point.discrepancy <= self.options.discrepancy

    def is_out_of_time(self) -> bool:
        limit = self.options.max_time_s
        return limit is not None and time.perf_counter() - self.started > limit


class Sfc(Reconstructor):
    """Shape from Caustics.

    Args:
        scene: the set-up of the measurement.
        options: see :class:`~warp_caustics.reconstruct.sfc.options.SfcOptions`.
        device: where to simulate.

    Raises:
        InputError: the wavelet does not fit the heights.
    """

    name = "sfc"

    def __init__(self, scene: Scene, options: SfcOptions | None = None, device: str | torch.device = "cpu"):
        self.scene, self.options, self.device = scene, options or SfcOptions(), usable_device(device)
        self._basis: WaveletBasis | None = None
        if self.options.variant == "landweber_wavelet":
            self._basis = WaveletBasis(scene.height_samples, self.options.wavelet, self.options.wavelet_levels)

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
        started = time.perf_counter()
        check_image(image, self.scene)
        if initial is not None:
            check_initial(initial, self.scene)
        options, n = self.options, self.scene.height_samples
        knowledge = gather(
            options.mask_or_default, options.volume_or_default, options.oracle_heights_m, image, self.scene
        )
        heights: FloatArray = np.zeros((n, n)) if initial is None else initial.astype(np.float64)
        pixels = self._pixels()
        measurement = measurement_at(image, self.scene, pixels, self.device, options.border_pixels)
        run = _Run(options, progress, started)
        point = start = self._evaluate(measurement, self._simulator(pixels, 0), heights)
        step = 0.0
        reason: StopReason = "discrepancy"
        try:
            if not run.has_reached_noise(start):
                update, step = self._update(measurement, self._simulator(pixels, 0), knowledge, start)
                point, reason = self._iterate(measurement, pixels, update, step, start, run)
        except KeyboardInterrupt:
            point, reason = run.best or start, "interrupted"
        run.timings["descent"] = time.perf_counter() - started
        return self._result(image, point, start, reason, step, run, knowledge, pixels)

    def _pixels(self) -> int:
        """Image size used: on a CPU at most twice as many pixels as samples, as ``refine`` does."""
        finest = self.options.finest_pixels or self.scene.image_pixels
        if self.options.finest_pixels is None and self.device.type == "cpu":
            while finest > 2 * self.scene.height_samples and finest % 2 == 0:
                finest //= 2
        return level_sizes(self.scene.image_pixels, finest, finest)[-1]

    def _simulator(self, pixels: int, iteration: int) -> CausticSimulator:
        # In units of the radiosity, so that weights mean the same for dim and bright light.
        ones = tuple(float(r > 0) for r in self.scene.radiosity_W_m2)
        scene = self.scene.model_copy(update={"image_pixels": pixels, "radiosity_W_m2": ones})
        o = self.options
        return CausticSimulator(scene, o.preset, n_photons=o.n_photons, seed=o.seed + iteration, device=self.device)

    def _evaluate(self, measurement: Measurement, simulator: CausticSimulator, heights: FloatArray) -> _Point:
        """Objective and gradient at a relief."""
        options = self.options
        leaf = torch.tensor(heights, dtype=torch.float32, device=self.device, requires_grad=True)
        image = simulator(leaf)
        objective = data_term(image, measurement, options.data_term)
        if options.total_variation:
            objective = objective + options.total_variation * total_variation(leaf, self.scene.sample_pitch_m)
        objective.backward()
        assert leaf.grad is not None
        with torch.no_grad():
            residual = measurement.relative_residual(image)
            discrepancy = measurement.discrepancy(image)
        if options.relative_noise is not None:
            discrepancy = residual / options.relative_noise
        return _Point(heights, float(objective.detach()), leaf.grad.double().cpu().numpy(), residual, discrepancy)

    def _update(
        self, measurement: Measurement, simulator: CausticSimulator, knowledge: Knowledge, start: _Point
    ) -> tuple[Update, float]:
        """The variant's update and its first step tau [m^2].

        The step is relative to 1 / L of the l2 term. The l1 term is the l2 term with weights 1 / |r|, so its step is
        that of the l2 term times a typical |r|.
        """
        options = self.options
        largest = curvature(simulator, measurement, start.heights)
        if largest == 0:
            raise InputError("the image does not depend on the heights; check mask, wavelengths and screen position")
        step = options.step / largest
        if options.data_term == "l1":
            step *= self._typical_residual(measurement, simulator, start.heights)
        if options.variant == "baseline":
            return PlainUpdate(-DEEPEST_FRACTION * self.scene.base_thickness_m, MAX_RELIEF_M), step
        band = None
        if knowledge.volume_m3 is not None:
            band = VolumeBand(knowledge.volume_m3, options.volume_tolerance, options.volume_gain)
        threshold = options.shrinkage * float(np.abs(start.gradient).max())
        mask = knowledge.mask.astype(np.float64)
        pixels = PixelUpdate(threshold, options.lowest_m, options.highest_m, mask, band, self.scene.sample_pitch_m)
        if self._basis is None:
            return pixels, step
        threshold = options.wavelet_shrinkage * float(np.abs(self._basis.adjoint(start.gradient)).max())
        return WaveletUpdate(self._basis, threshold, pixels), step / self._basis.squared_norm()

    def _typical_residual(self, measurement: Measurement, simulator: CausticSimulator, heights: FloatArray) -> float:
        """Upper quartile of |r|: of pixels that see print, not of a few broken ones."""
        with torch.no_grad():
            image = simulator(torch.tensor(heights, dtype=torch.float32, device=self.device))
        residual = (image - measurement.irradiance).abs()[measurement.weight > 0]
        return max(float(np.quantile(residual.cpu().numpy(), 0.75)), 1e-6)

    def _iterate(
        self, measurement: Measurement, pixels: int, update: Update, step: float, start: _Point, run: _Run
    ) -> tuple[_Point, StopReason]:
        """All iterations; returns the relief to keep and why they ended.

        Kept is the iterate of lowest objective, not the last: fixed steps do not descend from one to the next. The
        start is none of them, so that a single iteration can be looked at.
        """
        simulator, point = self._simulator(pixels, 0), start
        for iteration in range(1, self.options.max_iterations + 1):
            if self.options.preset == "paper":
                simulator = self._simulator(pixels, iteration)
            before = point
            point, step, next_step = self._advance(measurement, simulator, update, step, before)
            run.note(point, step)
            step = next_step
            if run.has_reached_noise(point):
                return point, "discrepancy"
            assert run.best is not None
            if np.abs(point.heights - before.heights).max() <= CONVERGED_M:
                return run.best, "converged"
            if run.is_out_of_time():
                return run.best, "max_time"
        assert run.best is not None
        return run.best, "max_iterations"

    def _advance(
        self, measurement: Measurement, simulator: CausticSimulator, update: Update, step: float, point: _Point
    ) -> tuple[_Point, float, float]:
        """One iteration: the new relief, the step it took and the step to try next."""
        candidate = self._evaluate(measurement, simulator, update(point.heights, point.gradient, step))
        if self.options.step_control == "fixed":
            return candidate, step, step
        if candidate.objective <= point.objective:
            return candidate, step, GROWTH * step
        for _ in range(MAX_HALVINGS):
            step /= 2
            candidate = self._evaluate(measurement, simulator, update(point.heights, point.gradient, step))
            if candidate.objective <= point.objective:
                break
        return candidate, step, step

    def _result(
        self,
        image: CausticImage,
        point: _Point,
        start: _Point,
        reason: StopReason,
        step: float,
        run: _Run,
        knowledge: Knowledge,
        pixels: int,
    ) -> Reconstruction:
        started = time.perf_counter()
        # Always the lattice and all pixels: what was found is judged by the best simulation there is.
        simulator = CausticSimulator(self.scene, "lattice", device=self.device)
        found = torch.tensor(point.heights, dtype=torch.float32, device=self.device)
        measurement = measurement_at(image, self.scene, self.scene.image_pixels, self.device)
        radiosity = torch.tensor(self.scene.radiosity_W_m2, device=self.device)[:, None, None]
        with torch.no_grad():
            simulated = simulator(found)
            residual = measurement.relative_residual(simulated / radiosity.clamp_min(1e-30))
        counters = {
            "start_residual": start.residual,
            "volume_m3": relief_volume(point.heights, self.scene.sample_pitch_m),
            "energy": energy_budget(simulator, found),
        }
        settings = self.options.record() | {"knowledge": knowledge.record(), "levels": [pixels], "first_step_m2": step}
        settings["simulation"] = self._simulator(pixels, 0).settings()
        return Reconstruction(
            method=self.name,
            heights_m=point.heights,
            image=simulated.cpu().numpy(),
            residual=residual,
            stop_reason=reason,
            history=run.history,
            timings_s=run.timings | {"resimulation": time.perf_counter() - started},
            counters=counters,
            settings=settings,
            warnings=tuple(self._warnings(point, start, reason, knowledge, pixels)),
        )

    def _warnings(
        self, point: _Point, start: _Point, reason: StopReason, knowledge: Knowledge, pixels: int
    ) -> Iterator[str]:
        """What the user should know."""
        options = self.options
        if knowledge.is_oracle:
            sources = {"mask": knowledge.mask_source, "volume": knowledge.volume_source}
            told = " and ".join(name for name, source in sources.items() if source == "oracle")
            yield f"{told} derived from the true relief (oracle): privileged knowledge that no measurement has"
        if pixels < self.scene.image_pixels:
            m = self.scene.image_pixels
            yield f"image binned to {pixels} pixels to save time; finest_pixels={m} uses all"
        if point.discrepancy is None and options.discrepancy > 0:
            yield "the noise of the image is unknown, so nothing stopped the iteration at it; give relative_noise"
        if reason == "max_iterations" and point.discrepancy is not None and 0 < options.discrepancy < point.discrepancy:
            yield (
                f"no convergence: {options.max_iterations} iterations left {point.discrepancy:.3g} times the noise, "
                f"the limit is {options.discrepancy:g}; raise max_iterations, or start nearer to the truth (initial)"
            )
        if point.residual > start.residual:
            yield (
                f"no convergence: the residual is {point.residual:.3g}, above the {start.residual:.3g} of the start; "
                "lower step"
            )
