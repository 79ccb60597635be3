"""Reconstruction of a plate whose design is known: what was meant, unless the image says otherwise.

Descent from the design finds small deviations exactly and large ones (a
missing fibre) never; a network that is told nothing finds large ones, and errs
on folds and crossings, where several reliefs give the image. So

1. lines are looked for in the network's answer: those of the design, if it is a
   list of lines (``warp_caustics.prints.fit``), else whatever lines there are
   (``warp_caustics.prints.vectorise``), and fitted to the image (``fibres/search.py``).
   Where nothing but noise is left of the image, and no part of the network's
   answer or of the design fits better, this is the result;
2. else network, design and lines are candidates: part by part of the plate that
   is taken whose caustic fits the image there (``selection.py``);
3. that is refined on the exact model, in the end at all pixels; the design's
   lines are found once more, and the parts chosen once more.

Limit: where no candidate is near the truth, the result is not either. The
uncertainty (``from_design_uncertainty.py``) does not tell of it; the residual may.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import torch
from pydantic import Field

from nets.inspection.selection import MisfitMap, better_parts
from nets.reconstruct import methods
from nets.reconstruct.fibres.explained import Discrepancy, is_explained
from nets.reconstruct.fibres.search import ITERATIONS, LAST, LineSearch
from nets.reconstruct.fibres.uncertainty import (
    EXPLAINED_LINES,
    LINES,
    RELIEF,
    SPREADS,
    design_uncertainty,
    disagreement,
)
from nets.reconstruct.network_io import network_result
from nets.reconstruct.uncertainty import DIRECT_CALIBRATION
from warp_caustics.errors import InputError, MismatchError
from warp_caustics.prints.fit import FittedLine, fit_lines
from warp_caustics.prints.line import Line, Section, line_relief
from warp_caustics.prints.vectorise import lines_of_relief
from warp_caustics.prints.vectorise.model import Limits, LineModel
from warp_caustics.reconstruct.base import CausticImage, Progress, ProgressCallback, Reconstruction, StopReason
from warp_caustics.reconstruct.pyramid import check_image, check_initial
from warp_caustics.reconstruct.refine.options import RefineOptions
from warp_caustics.reconstruct.refine.refine import Refine
from warp_caustics.reconstruct.result import Resimulation, as_glass
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator, usable_device
from warp_caustics.strict import Strict
from warp_caustics.types import FloatArray

SEEN_M = 2e-5
"""Lines lower than this are missing [m]."""
UNKNOWN_SPREAD_M = 5e-6
"""Taken for the spread of an answer that has none, where lines are looked for in it [m]."""


class DesignOptions(Strict):
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


@dataclass(frozen=True, eq=False)
class DesignResult:
    """A plate whose design is known.

    Attributes:
        reconstruction: as every method returns it.
        lines: the design's lines as they were printed; empty where the design is no list.
    """

    reconstruction: Reconstruction
    lines: tuple[FittedLine, ...]


class FromDesign:
    """Reconstruction of plates of one scene with a known design.

    Args:
        scene: the set-up of the measurement.
        options: see :class:`DesignOptions`.
        device: where to compute.
    """

    name = "design"

    def __init__(self, scene: Scene, options: DesignOptions | None = None, device: str | torch.device = "cpu"):
        self.scene, self.options, self.device = scene, options or DesignOptions(), usable_device(device)
        self.simulator = CausticSimulator(scene, "lattice", device=self.device)
        self.refusal: str | None = None
        try:
            self.free = methods.create("direct", scene, device=self.device, refine=False, weights=self.options.weights)
        except (InputError, MismatchError) as error:
            if self.options.weights is not None:
                raise
            self.refusal = str(error)
            self.free = methods.create("auto", scene, device=self.device)

    def reconstruct(
        self,
        image: CausticImage,
        nominal: FloatArray,
        lines: Sequence[Line] = (),
        *,
        profile: Section = "cosine",
        progress: ProgressCallback | None = None,
    ) -> DesignResult:
        """Recover the relief.

        Ctrl-C returns the best relief so far, ``stop_reason`` then is ``interrupted``.

        Args:
            image: the measured caustic.
            nominal: the design's relief [m], shape [n, n].
            lines: of which it consists, if it is a list of lines.
            profile: of the lines.
            progress: called after every iteration.

        Raises:
            InputError: image or design do not fit the scene.
        """
        image = check_image(image, self.scene)
        check_initial(nominal, self.scene)
        run = _Run(self, image, nominal, list(lines), profile, progress)
        reason: StopReason = "max_iterations"
        try:
            run.all()
        except KeyboardInterrupt:
            reason = "interrupted"
        return run.result(reason)


def as_rows(lines: Sequence[Line]) -> torch.Tensor:
    """Lines as ``warp_caustics.prints.vectorise`` has them, shape [L, 6] [mm], float64."""
    rows = [[*line.start_m, *line.end_m, line.width_m, line.height_m] for line in lines]
    return 1e3 * torch.tensor(rows, dtype=torch.float64).reshape(-1, 6)


def limits_around(lines: Sequence[Line], plate_size_m: tuple[float, float]) -> Limits:
    """What a printed line may be: the usual, and half as much again as any line of the design."""
    usual = Limits()
    reaches = [
        2 * abs(x) / size
        for line in lines
        for end in (line.start_m, line.end_m)
        for x, size in zip(end, plate_size_m, strict=True)
    ]
    widths, heights = [1e3 * line.width_m for line in lines], [1e3 * line.height_m for line in lines]
    return Limits(
        reach=max([usual.reach, *(reach + 0.08 for reach in reaches)]),
        width_mm=(min([usual.width_mm[0], *(w / 1.5 for w in widths)]), 1.5 * max([usual.width_mm[1] / 1.5, *widths])),
        height_mm=(usual.height_mm[0], 1.5 * max([usual.height_mm[1] / 1.5, *heights])),
    )


class _Run:
    """State of one reconstruction."""

    def __init__(
        self,
        method: FromDesign,
        image: CausticImage,
        nominal: FloatArray,
        lines: list[Line],
        profile: Section,
        progress: ProgressCallback | None,
    ):
        self.method, self.scene, self.options = method, method.scene, method.options
        self.nominal, self.lines, self.profile, self.progress = nominal.astype(np.float64), lines, profile, progress
        self.counters: dict[str, Any] = {"misfit": {}}
        self._judge_by(Resimulation(method.simulator, image).exposed(self.nominal))
        self.model = LineModel(method.scene, profile, method.device, limits_around(lines, method.scene.plate_size_m))
        self.best: FloatArray = self.nominal
        self.spread: FloatArray | None = None
        self.free: FloatArray | None = None
        self.fitted: tuple[FittedLine, ...] = ()
        self.is_explained = False
        self.history: list[dict[str, Any]] = []
        self.timings: dict[str, float] = {}
        self.warnings: list[str] = []
        self.started = time.perf_counter()

    def _judge_by(self, resimulation: Resimulation) -> None:
        self.resimulation, self.image = resimulation, resimulation.image
        self.misfit = MisfitMap(self.method.simulator, self.image)
        self.counters["misfit"]["nominal"] = self.total(self.nominal)

    def all(self) -> None:
        """Every step, one after the other."""
        self._timed("free", self._answer)
        assert self.free is not None
        candidates = [self.free, self.nominal]
        if self.lines:
            candidates.append(self._timed("lines", self._lines_in, self.free))
        fits = self.options.fit_lines
        if bool(self.lines) if fits is None else fits:
            printed = self._timed("lines", self._lines_at_start)
            found = self._timed("image fit", self._fitted_to_image, printed)
            if self.is_explained and self._timed("selection", self._is_best_everywhere, found):
                self.best = found
                if self.lines:
                    self._timed("lines", self._lines_in, self.best)
                return
            self.is_explained = False
            candidates.append(found)
        self._timed("selection", self._select, candidates, self.options.rounds)
        if self.options.coarse_iterations and not self.lines:
            self._timed("refinement", self._refine, self._coarse_pixels(), self.options.coarse_iterations)
            self._timed("selection", self._select, candidates, 1)
        if self.options.iterations:
            self._timed("refinement", self._refine, self.scene.image_pixels, self.options.iterations)
        if self.lines:
            again = self._timed("lines", self._lines_in, self.best)
            self._timed("selection", self._select, [again], 1)

    def _lines_at_start(self) -> torch.Tensor:
        """Lines in the network's answer, shape [L, 6] [mm]: of the design, or whatever there are."""
        if self.lines:
            return as_rows([fit.line for fit in self.fitted if fit.line.height_m > SEEN_M])
        assert self.free is not None
        heights = torch.as_tensor(self.free)
        spread = torch.zeros_like(heights) if self.spread is None else torch.as_tensor(self.spread) / SPREADS
        return lines_of_relief(self.model, heights, spread)

    def _fitted_to_image(self, lines: torch.Tensor) -> FloatArray:
        """Relief of lines that explain the image better; notes whether anything but noise is left of it."""
        model = self.model
        search = LineSearch(
            self.scene,
            self.image,
            model,
            self._coarse_pixels() if self.method.device.type == "cpu" else self.scene.image_pixels,
            jumps=0 if self.lines else self.options.jumps,
            report=self._note,
        )
        found = as_glass(1e-3 * model.heights(search.run(model.clamped(lines))).double().cpu().numpy(), self.scene)
        self.counters["misfit"]["image fit"] = self.total(found)
        left = Discrepancy(self.scene, self.image, self.method.device)(found)
        self.counters["discrepancy"] = left
        self.is_explained = is_explained(left)
        return found

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
            steps = ITERATIONS * (1 if self.lines else self.options.jumps + 2) + LAST
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
            # Lines are fitted to channels that lie together; their model knows no blur.
            camera = ChannelCamera.of_record(result.counters["camera"], self.scene.image_pixels)
            self.counters["camera"] = camera.record
            if camera.displaces:
                self._judge_by(self.resimulation.through(camera.sharp()))
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

    def _lines_in(self, heights_m: FloatArray) -> FloatArray:
        """Relief of the design's lines where a relief has them."""
        spread = np.full(heights_m.shape, UNKNOWN_SPREAD_M) if self.spread is None else self.spread
        self.fitted = tuple(fit_lines(self.lines, heights_m, spread, self.scene.plate_size_m, profile=self.profile))
        found = line_relief(
            [fit.line for fit in self.fitted], len(heights_m), self.scene.plate_size_m, profile=self.profile
        )
        self.counters["misfit"]["lines"] = self.total(found)
        return found

    def _select(self, candidates: Sequence[FloatArray], rounds: int) -> None:
        start = min((self.best, *candidates), key=self.total)
        pitch = min(self.scene.sample_pitch_m)
        self.best = better_parts(self.misfit, start, candidates, pitch, rounds)
        self.counters["misfit"]["selection"] = self.total(self.best)

    def _coarse_pixels(self) -> int:
        return RefineOptions().resolved("height", False, self.scene, "cpu").finest_pixels or self.scene.image_pixels

    def _refine(self, pixels: int, iterations: int) -> None:
        refine = Refine(
            self.scene,
            RefineOptions(
                metric="height",
                coarsest_pixels=pixels,
                finest_pixels=pixels,
                max_iterations=iterations,
                step_m=self.options.step_m,
            ),
            self.method.device,
        )
        result = refine.reconstruct(self.image, initial=self.best, progress=self._shifted(iterations))
        done, elapsed = len(self.history), time.perf_counter() - self.started
        self.history += [
            entry | {"iteration": done + k + 1, "elapsed_s": elapsed + entry["elapsed_s"]}
            for k, entry in enumerate(result.history)
        ]
        # Binned to fewer pixels the misfit may fall while that of all pixels rises a little; later steps mend it.
        if pixels < self.scene.image_pixels or self.total(result.heights_m) < self.total(self.best):
            self.best = result.heights_m
        self.counters["misfit"]["refinement"] = self.total(self.best)
        if result.stop_reason == "interrupted":
            raise KeyboardInterrupt

    def _shifted(self, iterations: int) -> ProgressCallback | None:
        report, done, started = self.progress, len(self.history), self.started
        if report is None:
            return None

        def show(state: Progress) -> None:
            elapsed = time.perf_counter() - started
            report(Progress("refinement", done + state.iteration, done + iterations, state.residual, elapsed))

        return show

    def result(self, reason: StopReason) -> DesignResult:
        """What was found so far."""
        sigma = None
        self.counters["explained_by_lines"] = self.is_explained
        if self.spread is not None:
            kind = EXPLAINED_LINES if self.is_explained else LINES if self.lines else RELIEF
            sigma = design_uncertainty(self.spread, kind)
        elif self.free is not None:
            sigma = disagreement(self.best, self.free)
        reconstruction = network_result(
            FromDesign.name,
            self.resimulation,
            as_glass(self.best, self.scene),
            reason=reason,
            history=self.history,
            timings=self.timings,
            counters=self.counters,
            settings=self.options.model_dump() | {"free": self.method.free.name, "lines": len(self.lines)},
            warnings=self.warnings,
            uncertainty=sigma,
        )
        return DesignResult(reconstruction, self.fitted)
