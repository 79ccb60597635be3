"""Reconstruction of a plate whose design is known: what was meant, unless the image says otherwise.

Descent from the design finds small deviations exactly and large ones (a
missing fibre) never; a network that is told nothing finds large ones, and errs
on folds and crossings, where several reliefs give the image. So

1. lines are looked for in the network's answer and fitted to the image (``line_candidates.py``), and where they leave
   more than noise also the bench that they tell (``bench_of_design.py``). Where nothing but noise is left of the image,
   and no part of the network's answer or of the design fits better, this is the result;
2. else network, design and lines are candidates: part by part of the plate that
   is taken whose caustic fits the image there (``selection.py``);
3. that is refined on the exact model, in the end at all pixels; the design's
   lines are fitted once more, and the parts chosen once more.

Limit: where no candidate is near the truth, the result is not either. What is
left of the image and how well the bench is known are part of the uncertainty.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, Literal

import numpy as np
import torch
from pydantic import Field

from nets.inspection.bench_of_design import OnBench, bench_of_design
from nets.inspection.lens_of_design import lens_of_design
from nets.inspection.line_candidates import LineCandidates
from nets.inspection.selection import MisfitMap, better_parts
from nets.reconstruct import methods
from nets.reconstruct.fibres.bench.bench_and_light import as_measured
from nets.reconstruct.fibres.image.discrepancy import is_explained
from nets.reconstruct.fibres.image.lines_view import LinesView
from nets.reconstruct.fibres.search.line_search import Answer
from nets.reconstruct.fibres.trust.uncertainty import (
    EXPLAINED_LINES,
    LINES,
    RELIEF,
    SPREADS,
    design_uncertainty,
    disagreement,
)
from nets.reconstruct.losses_of_light import effects_of
from nets.reconstruct.network_io import network_result
from nets.reconstruct.uncertainty import DIRECT_CALIBRATION
from nets.reconstruct.with_bench import with_bench
from nets.reconstruct.with_causes import with_causes
from nets.reconstruct.with_doubt import with_doubt
from warp_caustics.errors import InputError, MismatchError
from warp_caustics.found_bench.bench_numbers import BenchNumbers
from warp_caustics.inspection.nominal import Nominal
from warp_caustics.prints.fit_design import FittedLine
from warp_caustics.reconstruct.base import CausticImage, Progress, ProgressCallback, Reconstruction, StopReason
from warp_caustics.reconstruct.pyramid import check_image, check_initial, measurement_at, simulator_at
from warp_caustics.reconstruct.refine.height_descent import HeightDescent
from warp_caustics.reconstruct.refine.options import RefineOptions
from warp_caustics.reconstruct.rest import local_relief
from warp_caustics.reconstruct.result import Resimulation, as_glass
from warp_caustics.reconstruct.run_log import RunLog, following, note_evaluation, why_stopped
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.resampling import blur_matrices
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator, usable_device
from warp_caustics.strict import Strict
from warp_caustics.types import FloatArray

PLAIN = {"bench_uncertainty": False, "flatness_m": 0.0, "causes": False, "set_up": "known"}
"""Of the network's answer, which is a start on the bench that is told: how far it disagrees with itself, and nothing
else."""


class FromNominalOptions(Strict):
    """Settings of a reconstruction from a design."""

    weights: str | None = None
    """Weights file of the network; None takes a shipped one that knows the scene."""
    coarse_iterations: Annotated[int, Field(ge=0, le=10_000)] = 40
    """Steps of refinement at 2n pixels, for a design that is no list of lines."""
    iterations: Annotated[int, Field(ge=0, le=10_000)] = 8
    """Steps of refinement at all pixels."""
    step_m: Annotated[float, Field(gt=0, le=1e-4, allow_inf_nan=False)] = 5e-6
    """First step [m]."""
    rounds: Annotated[int, Field(ge=1, le=10)] = 1
    """How often parts of the plate are chosen in a row."""
    fit_lines: bool | None = None
    """Whether to fit lines to the image first; None: where the design is a list of lines. Of another design all lines
    are searched for, which takes minutes on a CPU."""
    jumps: Annotated[int, Field(ge=0, le=20)] = 3
    """Rounds of jumps of lines that no design tells of, at most; see ``fibres``."""
    set_up: Literal["known", "estimate"] | None = None
    """Whether the bench is as it is told, or found with the design's lines where they leave more than noise; None: it
    is found on a GPU. Of many lines it takes a CPU minutes."""
    priors: dict[str, Annotated[float, Field(ge=0, allow_inf_nan=False)]] = Field(default_factory=dict)
    """Standard deviations of what is told of the bench, by name; 0 is exact."""
    bench_uncertainty: bool = True
    """Whether the standard uncertainty knows how well the bench is known."""
    causes: bool = True
    """Whether what is left of the image is part of the standard uncertainty, and asked what it looks like."""


@dataclass(frozen=True, eq=False)
class FromNominalResult:
    """A plate whose design is known.

    Attributes:
        reconstruction: as every method returns it.
        lines: the design's lines as they were printed; empty where the design is no list.
    """

    reconstruction: Reconstruction
    lines: tuple[FittedLine, ...]


class FromNominal:
    """Reconstruction of plates of one scene with a known design.

    Args:
        scene: the set-up of the measurement.
        options: see :class:`FromNominalOptions`.
        device: where to compute.
    """

    name = "design"

    def __init__(self, scene: Scene, options: FromNominalOptions | None = None, device: str | torch.device = "cpu"):
        self.scene, self.options, self.device = scene, options or FromNominalOptions(), usable_device(device)
        self.simulator = CausticSimulator(scene, "lattice", device=self.device)
        self.numbers = BenchNumbers.of(scene, self.options.priors)
        self.finds_bench = (self.options.set_up or ("estimate" if self.device.type == "cuda" else "known")) != "known"
        self.refusal: str | None = None
        try:
            self.free = methods.create(
                "direct", scene, device=self.device, refine=False, weights=self.options.weights, **PLAIN
            )
        except (InputError, MismatchError) as error:
            if self.options.weights is not None:
                raise
            self.refusal = str(error)
            self.free = methods.create("auto", scene, device=self.device, **PLAIN)

    def reconstruct(
        self,
        image: CausticImage,
        nominal: Nominal,
        *,
        progress: ProgressCallback | None = None,
    ) -> FromNominalResult:
        """Recover the relief.

        Ctrl-C returns the best relief so far, ``stop_reason`` then is ``interrupted``.

        Args:
            image: the measured caustic.
            nominal: the design.
            progress: called after every iteration.

        Raises:
            InputError: image or design do not fit the scene.
        """
        image = check_image(image, self.scene)
        check_initial(nominal.relief_m, self.scene)
        run = _Run(self, image, nominal, progress)
        reason: StopReason = "max_iterations"
        try:
            run.all()
        except KeyboardInterrupt:
            reason = "interrupted"
        return run.result(reason)


class _Run:
    """State of one reconstruction."""

    def __init__(
        self,
        method: FromNominal,
        image: CausticImage,
        nominal: Nominal,
        progress: ProgressCallback | None,
    ):
        self.method, self.scene, self.options, self.measured = method, method.scene, method.options, image
        self.nominal, self.has_lines, self.progress = nominal.relief_m.astype(np.float64), bool(nominal.lines), progress
        self.lines = LineCandidates(method.scene, nominal, method.device)
        self.counters: dict[str, Any] = {"misfit": {}}
        self._judge_by(Resimulation(method.simulator, image).exposed(self.nominal))
        self.best: FloatArray = self.nominal
        self.spread: FloatArray | None = None
        self.free: FloatArray | None = None
        self.is_explained = False
        self.on_bench: OnBench | None = None
        self.history: list[dict[str, Any]] = []
        self.timings: dict[str, float] = {}
        self.warnings: list[str] = []
        self.started = time.perf_counter()

    def _judge_by(self, resimulation: Resimulation) -> None:
        self.resimulation, self.image = resimulation, resimulation.image
        self.misfit = MisfitMap(resimulation.simulator, self.image, resimulation.camera.blur)
        self.counters["misfit"]["nominal"] = self.total(self.nominal)

    def all(self) -> None:
        """Every step, one after the other."""
        self._timed("free", self._answer)
        assert self.free is not None
        candidates = [self.free, self.nominal]
        if self.has_lines:
            candidates.append(self._timed("lines", self._lines_in, self.free))
        is_fitted = self.has_lines if self.options.fit_lines is None else self.options.fit_lines
        if is_fitted:
            printed = self._timed("lines", self.lines.start, self.free, self.spread)
            found = self._timed("image fit", self._fitted_to_image, printed)
            if self.is_explained and self._timed("selection", self._is_best_everywhere, found):
                self.best = found
                if self.has_lines:
                    self._timed("lines", self._lines_in, self.best)
                return
            self.is_explained = False
            candidates.append(found)
        self._timed("selection", self._select, candidates, self.options.rounds)
        if self.options.coarse_iterations and not self.has_lines:
            self._timed("refinement", self._refine, self._coarse_pixels(), self.options.coarse_iterations)
            self._timed("selection", self._select, candidates, 1)
        if self.options.iterations:
            self._timed("refinement", self._refine, self.scene.image_pixels, self.options.iterations)
        if self.has_lines:
            again = self._timed("lines", self._lines_in, self.best)
            self._timed("selection", self._select, [again], 1)

    def _lines_in(self, heights_m: FloatArray) -> FloatArray:
        """Relief of the design's lines where a relief has them."""
        found = self.lines.in_relief(heights_m, self.spread)
        self.counters["misfit"]["lines"] = self.total(found)
        return found

    def _fitted_to_image(self, lines: torch.Tensor) -> FloatArray:
        """Relief of lines that explain the image better; notes whether anything but noise is left of it."""
        told = view = LinesView(self.resimulation, self.lines.model)
        found, view = lens_of_design(self._fitted(lines, view), view, self._fitted)
        if self.method.finds_bench and len(found) and not view.is_explained(found):
            numbers = self.method.numbers
            self.on_bench = bench_of_design(found, view, self.measured, numbers, self._fitted, self._note)
        if self.on_bench is not None:
            found, view = self.on_bench.lines, self.on_bench.view
        if view is not told:
            self._judge_by(view.resimulation)
            self.counters["camera"] = view.camera.record
        relief = view.relief(found)
        self.misfit.correct_at(relief, view.camera)
        self.counters["misfit"]["image fit"] = self.total(relief)
        self.counters["discrepancy"] = left = view.discrepancy(relief)
        self.is_explained = is_explained(left)
        return relief

    def _fitted(self, lines: torch.Tensor, view: LinesView) -> torch.Tensor:
        """Lines that explain a view better, shape [L, 6] [m]."""
        assert self.free is not None
        pixels = self._coarse_pixels() if self.method.device.type == "cpu" else self.scene.image_pixels
        spread = np.zeros_like(self.free) if self.spread is None else self.spread / SPREADS
        relief, apart = (torch.as_tensor(each).to(self.method.device, torch.float32) for each in (self.free, spread))
        answer = Answer(relief, apart)
        return self.lines.on_image(lines, view, pixels, self.options.jumps, self._note, answer)

    def _is_best_everywhere(self, found: FloatArray) -> bool:
        """Whether no part of the network's answer or of the design fits the image better.

        A small drop of glass that is no line hardly shows in the RMS over the whole image, but in its surroundings.
        """
        assert self.free is not None
        pitch = min(self.scene.sample_pitch_m)
        return better_parts(self.misfit, found, [self.free, self.nominal], pitch) is found

    def _note(self, loss: float) -> None:
        number, elapsed = len(self.history) + 1, time.perf_counter() - self.started
        entry = {"stage": "image fit", "iteration": number, "residual": None, "objective": loss, "elapsed_s": elapsed}
        self.history.append(entry)
        if self.progress is not None:
            steps = self.lines.iterations(self.options.jumps)
            self.progress(Progress("image fit", number, max(steps, number), float("nan"), elapsed))

    def total(self, heights_m: FloatArray) -> float:
        """Mean misfit of a relief [1]."""
        return float(self.misfit(heights_m).mean())

    def _timed(self, name: str, step: Callable[..., Any], *arguments: Any) -> Any:
        started = time.perf_counter()
        try:
            return step(*arguments)
        finally:
            self.timings[name] = self.timings.get(name, 0.0) + time.perf_counter() - started

    def _answer(self) -> None:
        """The relief that a method finds that is told nothing of the design."""
        result = self.method.free.reconstruct(self.image, progress=self.progress)
        self.history += result.history
        self.free = as_glass(result.heights_m, self.scene)
        if "camera" in result.counters:
            # Lines are fitted to channels that lie together, with the camera's blur in the model.
            camera = ChannelCamera.of_record(result.counters["camera"], self.scene.image_pixels)
            self.counters["camera"] = camera.record
            if not camera.is_perfect:
                self._judge_by(self.resimulation.through(camera))
        if result.uncertainty_m is not None:
            self.spread = SPREADS / DIRECT_CALIBRATION.scale * result.uncertainty_m.astype(np.float64)
        else:
            self.spread = None
        self.counters["misfit"]["free"] = self.total(self.free)
        self.counters["free_method"] = result.method
        if self.method.refusal is not None:
            self.warnings.append(f"no network can be used ({self.method.refusal}); {result.method} stands in for it")
        self.warnings += result.warnings if result.method == "direct" else ()
        if result.stop_reason == "interrupted":
            raise KeyboardInterrupt

    def _select(self, candidates: Sequence[FloatArray], rounds: int) -> None:
        start = min((self.best, *candidates), key=self.total)
        pitch = min(self.scene.sample_pitch_m)
        self.best = better_parts(self.misfit, start, candidates, pitch, rounds)
        self.counters["misfit"]["selection"] = self.total(self.best)

    def _coarse_pixels(self) -> int:
        return RefineOptions().resolved("height", False, self.scene, "cpu").finest_pixels or self.scene.image_pixels

    def _refine(self, pixels: int, iterations: int) -> None:
        scene, device, camera = self.resimulation.simulator.scene, self.method.device, self.resimulation.camera
        wished = RefineOptions(metric="height", max_iterations=iterations, step_m=self.options.step_m)
        options = wished.resolved("height", False, scene, device.type)
        descent = HeightDescent(simulator_at(scene, pixels, device), options)
        measurement = measurement_at(self.image, scene, pixels, device, options.border_pixels)
        blur = blur_matrices(pixels, camera.blur_at(pixels), device) if camera.blurs else None
        progress = following(self.progress, len(self.history), self.started, "")
        log = RunLog(descent.steps, progress, None, options.discrepancy, started=self.started)
        try:
            descent.run(measurement, self.best, partial(note_evaluation, log, "refinement"), blur)
        except KeyboardInterrupt as stop:
            if why_stopped(stop) == "interrupted":
                raise
        finally:
            done, found = len(self.history), descent.best_heights()
            self.history += [entry | {"iteration": done + k + 1} for k, entry in enumerate(log.history)]
            # Binned to fewer pixels the misfit may fall while that of all pixels rises a little; later steps mend it.
            if pixels < self.scene.image_pixels or self.total(found) < self.total(self.best):
                self.best = found
            self.counters["misfit"]["refinement"] = self.total(self.best)

    def result(self, reason: StopReason) -> FromNominalResult:
        """What was found so far."""
        heights, sigma, counters = as_glass(self.best, self.scene), None, self.counters
        counters["explained_by_lines"] = self.is_explained
        if self.spread is not None:
            kind = EXPLAINED_LINES if self.is_explained else LINES if self.has_lines else RELIEF
            sigma = design_uncertainty(self.spread, kind)
        elif self.free is not None:
            sigma = disagreement(self.best, self.free)
        is_asked = self.options.causes and reason != "interrupted"
        if is_asked and sigma is not None and not self.is_explained:
            rest = self.resimulation.rest(heights)
            if rest is not None:
                sigma = np.hypot(sigma, DIRECT_CALIBRATION.shared * rest.share * local_relief(heights))
        if self.on_bench is not None and sigma is not None:
            sigma = np.hypot(sigma, self.on_bench.deviation_m)
        if self.on_bench is not None:
            scene = self.resimulation.simulator.scene
            light = {"light": self.on_bench.bench.field.tolist()}
            counters = counters | {"bench": self.on_bench.record.record | light, "losses": effects_of(scene)}
            self.warnings += self.on_bench.record.warnings()
        reconstruction = network_result(
            FromNominal.name,
            self.resimulation,
            heights,
            reason=reason,
            history=self.history,
            timings=self.timings,
            counters=counters,
            settings=self.options.model_dump() | {"free": self.method.free.name, "lines": len(self.lines.designed)},
            warnings=self.warnings,
            uncertainty=sigma,
            no_uncertainty="no second reconstruction was made that tells how far another lies",
        )
        if self.on_bench is not None:
            on = self.on_bench
            reconstruction = as_measured(reconstruction, on.numbers, on.bench, self.resimulation.exposure)
        if is_asked:
            reconstruction = with_causes(
                reconstruction, self.measured, self.method.simulator, self.method.numbers, self.free
            )
        if self.options.bench_uncertainty:
            counted = () if self.on_bench is None else self.on_bench.asked
            # Defects are of lines: a bow of the base is none, and lifts a line with the plate beside it.
            reconstruction = with_bench(reconstruction, self.method.numbers, counted, flatness_m=0.0)
        return FromNominalResult(with_doubt(reconstruction), self.lines.fitted)
