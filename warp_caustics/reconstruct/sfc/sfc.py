"""``sfc``: Shape from Caustics (Kassubeck, Buergel, Castillo, Stiller, Magnor, WACV 2021), written anew.

Minimise D(h) = mean misfit of the simulated caustic over the heights, by one of three iterations from a flat relief:

* ``baseline``: gradient descent, no prior;
* ``landweber_pixel``: gradient step, soft shrinkage between bounds, mask, volume heuristic;
* ``landweber_wavelet``: gradient step and shrinkage on wavelet coefficients, then the same constraints on the pixels;

until the residual reaches the noise (Morozov) or the iterations are used up.

Departures from the published code: exact gradients (its hit distances carry none), steps and thresholds relative to the
problem, a volume heuristic that cannot change sign, mask and volume as inputs. docs/sfc.md says why and how tuned.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch

from warp_caustics.data_gradient import data_gradient, lowest_height_m
from warp_caustics.errors import InputError
from warp_caustics.reconstruct.base import CausticImage, ProgressCallback, Reconstruction, Reconstructor, StopReason
from warp_caustics.reconstruct.exposure import light_ratio, untreated_warning
from warp_caustics.reconstruct.objective import Measurement, total_variation
from warp_caustics.reconstruct.pyramid import (
    check_image,
    check_initial,
    in_units_of_radiosity,
    level_sizes,
    measurement_at,
    usual_pixels,
)
from warp_caustics.reconstruct.result import Resimulation, make_result
from warp_caustics.reconstruct.run_log import RunLog, why_stopped
from warp_caustics.reconstruct.sfc.constraints import Constraints, gather
from warp_caustics.reconstruct.sfc.landweber import (
    PixelUpdate,
    PlainUpdate,
    Update,
    WaveletUpdate,
    curvature,
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

STEP_GROWTH = 1.2
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


class _Iterates:
    """The latest relief and the one of lowest objective; fixed steps do not descend from one to the next.

    The start is none of them, so that a single iteration can be looked at.
    """

    def __init__(self, log: RunLog, stage: str):
        self.log, self.stage = log, stage
        self.latest: _Point | None = None
        self.best: _Point | None = None

    def note(self, point: _Point, step: float) -> None:
        """Take an iterate up.

        Raises:
            StopRun: the noise is reached, or the time is up.
        """
        self.latest = point
        if self.best is None or point.objective < self.best.objective:
            self.best = point
        self.log.note(
            self.stage,
            point.residual,
            noise=point.discrepancy,
            objective=point.objective,
            discrepancy=point.discrepancy,
            step=step,
        )

    def kept(self, reason: StopReason) -> _Point | None:
        """The relief to return: the first at the noise, else the best; None before the first."""
        return self.latest if reason == "discrepancy" else self.best


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
        options, n = self.options, self.scene.height_samples
        log = RunLog(options.max_iterations, progress, options.max_time_s, options.discrepancy)
        image = check_image(image, self.scene)
        if initial is not None:
            check_initial(initial, self.scene)
        constraints = gather(
            options.mask_or_default, options.volume_or_default, options.oracle_heights_m, image, self.scene
        )
        heights: FloatArray = np.zeros((n, n)) if initial is None else initial.astype(np.float64)
        pixels = self._pixels()
        measurement = measurement_at(image, self.scene, pixels, self.device, options.border_pixels)
        start = self._evaluate(measurement, self._simulator(pixels, 0), heights)
        iterates, step = _Iterates(log, options.variant), 0.0
        reason: StopReason = "discrepancy"
        try:
            if start.discrepancy is None or start.discrepancy > options.discrepancy:
                update, step = self._update(measurement, self._simulator(pixels, 0), constraints, start)
                reason = self._iterate(measurement, pixels, update, step, start, iterates)
        except KeyboardInterrupt as stop:
            reason = why_stopped(stop)
        point = iterates.kept(reason) or start
        resimulation = Resimulation(CausticSimulator(self.scene, "lattice", device=self.device), image)
        return make_result(
            self.name,
            resimulation,
            point.heights,
            reason=reason,
            history=log.history,
            timings={"descent": log.elapsed_s},
            counters={
                "start_residual": start.residual,
                "volume_m3": relief_volume(point.heights, self.scene.sample_pitch_m),
            },
            settings=options.record()
            | {
                "knowledge": constraints.record(),
                "levels": [pixels],
                "first_step_m2": step,
                "simulation": self._simulator(pixels, 0).settings(),
            },
            warnings=[*self._warnings(point, start, reason, constraints, pixels), *_light_warnings(resimulation)],
        )

    def _pixels(self) -> int:
        """Image size used: on a CPU at most twice as many pixels as samples, as ``refine`` does."""
        finest = self.options.finest_pixels
        if finest is None:
            finest = usual_pixels(self.scene) if self.device.type == "cpu" else self.scene.image_pixels
        return level_sizes(self.scene.image_pixels, finest, finest)[-1]

    def _simulator(self, pixels: int, iteration: int) -> CausticSimulator:
        scene = in_units_of_radiosity(self.scene, pixels)
        o = self.options
        return CausticSimulator(scene, o.preset, n_photons=o.n_photons, seed=o.seed + iteration, device=self.device)

    def _evaluate(self, measurement: Measurement, simulator: CausticSimulator, heights: FloatArray) -> _Point:
        """Objective and gradient at a relief."""
        options = self.options

        def objective(image: torch.Tensor, heights: torch.Tensor) -> torch.Tensor:
            misfit = measurement.data_term(image, options.data_term)
            if options.total_variation:
                misfit = misfit + options.total_variation * total_variation(heights, self.scene.sample_pitch_m)
            return misfit

        relief = torch.tensor(heights, dtype=torch.float32, device=self.device)
        found = data_gradient(simulator, relief, objective)
        residual = measurement.relative_residual(found.image)
        discrepancy = measurement.discrepancy(found.image)
        if options.relative_noise is not None:
            discrepancy = residual / options.relative_noise
        return _Point(heights, float(found.value), found.gradient.double().cpu().numpy(), residual, discrepancy)

    def _update(
        self, measurement: Measurement, simulator: CausticSimulator, constraints: Constraints, start: _Point
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
            return PlainUpdate(lowest_height_m(self.scene), MAX_RELIEF_M), step
        band = None
        if constraints.volume_m3 is not None:
            band = VolumeBand(constraints.volume_m3, options.volume_tolerance, options.volume_gain)
        threshold = options.shrinkage * float(np.abs(start.gradient).max())
        mask = constraints.mask.astype(np.float64)
        lowest_m = max(options.lowest_m, lowest_height_m(self.scene))
        pixels = PixelUpdate(threshold, lowest_m, options.highest_m, mask, band, self.scene.sample_pitch_m)
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
        self, measurement: Measurement, pixels: int, update: Update, step: float, start: _Point, iterates: _Iterates
    ) -> StopReason:
        """All iterations; returns why they ended.

        Raises:
            StopRun: the noise is reached, or the time is up.
        """
        simulator, point = self._simulator(pixels, 0), start
        for iteration in range(1, self.options.max_iterations + 1):
            if self.options.preset == "paper":
                simulator = self._simulator(pixels, iteration)
            before = point
            point, step, next_step = self._advance(measurement, simulator, update, step, before)
            iterates.note(point, step)
            step = next_step
            if np.abs(point.heights - before.heights).max() <= CONVERGED_M:
                return "converged"
        return "max_iterations"

    def _advance(
        self, measurement: Measurement, simulator: CausticSimulator, update: Update, step: float, point: _Point
    ) -> tuple[_Point, float, float]:
        """One iteration: the new relief, the step it took and the step to try next."""
        candidate = self._evaluate(measurement, simulator, update(point.heights, point.gradient, step))
        if self.options.step_control == "fixed":
            return candidate, step, step
        if candidate.objective <= point.objective:
            return candidate, step, STEP_GROWTH * step
        for _ in range(MAX_HALVINGS):
            step /= 2
            candidate = self._evaluate(measurement, simulator, update(point.heights, point.gradient, step))
            if candidate.objective <= point.objective:
                break
        return candidate, step, step

    def _warnings(
        self, point: _Point, start: _Point, reason: StopReason, constraints: Constraints, pixels: int
    ) -> Iterator[str]:
        """What the user should know."""
        options = self.options
        if constraints.is_oracle:
            sources = {"mask": constraints.mask_source, "volume": constraints.volume_source}
            told = " and ".join(name for name, source in sources.items() if source == "oracle")
            yield f"{told} derived from the true relief (oracle): privileged knowledge that no measurement has"
        if pixels < self.scene.image_pixels:
            m = self.scene.image_pixels
            fix = f"--set reconstruction.options.finest_pixels={m}"
            yield f"image binned to {pixels} pixels to save time; {fix} uses all"
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


def _light_warnings(resimulation: Resimulation) -> Iterator[str]:
    """The published scheme knows no exposure but that of the scene."""
    told = untreated_warning(light_ratio(resimulation.measurement), Sfc.name)
    if told is not None:
        yield told
