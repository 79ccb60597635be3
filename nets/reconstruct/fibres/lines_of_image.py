"""Lines of one image: found on the bench that was told, then with the one that they tell; and what becomes of them."""

import dataclasses
from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
import torch

from nets.reconstruct.fibres.bench.bench_and_light import Bench, seen_on
from nets.reconstruct.fibres.bench.bench_fits import fit_with_bench, fit_with_place
from nets.reconstruct.fibres.bench.bench_of_lines import BenchOfLines, numbers_of_lines
from nets.reconstruct.fibres.bench.camera_of_lines import (
    fit_through_blurring_lens,
    fit_through_lens,
    with_spread_of,
)
from nets.reconstruct.fibres.bench.far_gap import fit_far_away
from nets.reconstruct.fibres.bench.gap_fits import fit_with_gap
from nets.reconstruct.fibres.bench.lamp_of_lines import fit_with_lamp
from nets.reconstruct.fibres.bench.lens_or_light import fit_through_lens_or_with_light
from nets.reconstruct.fibres.bench.light_of_lines import fit_with_light, fit_with_losses
from nets.reconstruct.fibres.bench.line_posterior import JointCovariance
from nets.reconstruct.fibres.bench.noise_fits import fit_by_noise
from nets.reconstruct.fibres.bench.section_of_lines import fit_with_section_or_bench
from nets.reconstruct.fibres.fibres_of import FibresOf
from nets.reconstruct.fibres.image.discrepancy import is_explained
from nets.reconstruct.fibres.image.lines_view import LinesView
from nets.reconstruct.fibres.lines_result import result_of
from nets.reconstruct.fibres.search.line_search import ITERATIONS, Answer, LineSearch
from nets.reconstruct.fibres.search.other_starts import evolve, start_elsewhere
from nets.reconstruct.fibres.search.second_look import TAKEN_SHARE, look_again
from nets.reconstruct.fibres.search.starting_lines import starting_lines
from nets.reconstruct.fibres.shapes.curves_bench import curves_on_their_bench
from nets.reconstruct.fibres.shapes.curves_of_image import (
    MEETING_SHARE,
    Curved,
    CurvesOnImage,
    are_crowd,
    share_that_meet,
)
from nets.reconstruct.fibres.shapes.waves import WavyLines, waves_of
from nets.reconstruct.fibres.trust.stated_bench import stated_bench
from nets.reconstruct.fibres.trust.told_bench import with_way
from warp_caustics.found_bench.bench_numbers import BenchNumbers
from warp_caustics.found_bench.bench_record import is_picture_smaller
from warp_caustics.prints.model import LineModel
from warp_caustics.reconstruct.base import CausticImage, ProgressCallback, Reconstruction, StopReason
from warp_caustics.reconstruct.pyramid import usual_pixels
from warp_caustics.reconstruct.result import Resimulation
from warp_caustics.reconstruct.run_log import RunLog, why_stopped
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.simulator import CausticSimulator
from warp_caustics.types import FloatArray

NO_CROWD_SHARE = 1.5
"""Of what the network's relief leaves of the image, above which straight lines are no crowd of lines, however many, but
pieces of curves: rings that cross each other and the plate's edge leave 3.0, crowds that are not solved 0.9."""


class LinesOfImage:
    """One image: what was found so far.

    Args:
        method: whose image it is.
        image: without the stray light that was told.
        answer: of the network, not refined; on ``bench`` if that is given.
        started: when the method did, by ``time.perf_counter``.
        progress: called after each evaluation.
        bench: record of the one that was found without lines, and the stray light that was told; lines are found there,
            and the numbers that they tell as well.
        timings: of what went before [s].
    """

    def __init__(
        self,
        method: FibresOf,
        image: CausticImage,
        answer: Reconstruction,
        started: float,
        progress: ProgressCallback | None,
        bench: tuple[Mapping[str, Any], float] | None = None,
        timings: Mapping[str, float] | None = None,
    ):
        self.method, self.answer, self.measured = method, answer, image
        profile = method.options.profile
        self.model = LineModel(method.scene, "cosine" if profile == "found" else profile, method.device)
        self.exposure = np.asarray(answer.counters["exposure"], np.float64)
        self.camera = ChannelCamera.of_record(answer.counters["camera"], method.scene.image_pixels)
        # Lines are looked for in channels that lie together, and with the camera's blur in the model.
        self.most_lines = method.options.most_lines
        self.told = LinesView(
            Resimulation(method.network.simulator, image, self.exposure).through(self.camera), self.model
        )
        numbers = method.network.numbers
        clear = BenchNumbers.of(numbers.scene, numbers.told_widths)
        if bench is not None and bench[0]["is_picture"]:
            clear = dataclasses.replace(clear, is_picture=True)
        is_smaller = bench is not None and is_picture_smaller(bench[0])
        self.numbers = numbers_of_lines(clear, is_smaller=is_smaller)
        """Beside an image that told stray light has been taken off."""
        self.is_elsewhere = bench is not None
        self.bench = Bench.told(self.numbers) if bench is None else Bench.found(self.numbers, *bench)
        self.view = self.on(self.bench, self.camera) if self.is_elsewhere else self.told
        """On the bench that explains the image best."""
        self.iterations = method.options.max_iterations or ITERATIONS
        total = (method.options.jumps + 2) * self.iterations
        self.log = RunLog(total, progress, method.options.max_time_s, started=started, history=list(answer.history))
        self.reason: StopReason = "converged"
        self.refined_steps = 0
        """Of refinements, which are not in the history."""
        self.said = Answer.of(answer, self.most_lines)
        """Of the network, as it looks on the bench."""
        self.lines = torch.zeros(0, 6, dtype=torch.float64)
        self.covariance: JointCovariance | None = None
        """Of lines and bench, where both were found; ``counted`` are those lines, ``asked`` the bench's numbers."""
        self.counted = self.lines
        self.asked: Collection[str] = self.numbers.names
        self.hinted = 0.0
        """Share by which light goes farther than on the bench, as lines hint but do not tell."""
        self.told_share: tuple[float, float] | None = None
        """Share by which light goes farther than on the bench, and its standard deviation, where lines were asked."""
        self.waves: WavyLines | None = None
        """Along the lines, where they explain clearly more."""
        self.curves: CurvesOnImage | None = None
        """Instead of straight lines."""
        self.way_sigma: float | None = None
        """Of how far light goes, relative to it, where curves told that."""
        self.moves_section = False
        self.is_left_alone = self.is_crowd = False
        """Whether corners and curves are not asked for, and whether that is so because straight lines are many."""
        self.takes_lines = self.is_noise_left = self.is_in_vain = False
        self.seconds, self.timings, self.counters = 0.0, dict(timings or {}), dict[str, Any]()

    def leave(self) -> None:
        """No lines."""
        self.seconds = self.timings["network"] = self.log.elapsed_s
        self.counters = {"fibres": 0}

    def fit(self) -> None:
        """Lines, and the bench that they tell where they do not explain the image on the one that was told."""
        here = "network again" if self.is_elsewhere else "network"
        self.timings[here] = self.log.elapsed_s - sum(self.timings.values())
        try:
            self.fit_to(self.said)
            fit_far_away(self)
            self.timings["fibres"] = self.log.elapsed_s - sum(self.timings.values())
            if len(self.lines) and (not self.is_in_vain or self._starts_elsewhere()):
                self._fit_with_all()
                if self._looked_at_again() and self._is_near():
                    self._fit_with_all()
                self._fit_by_noise()
            if self.covariance is not None and self.counted is not self.lines:
                self.covariance = self.together(self.asked).covariance(self.lines, self.bench)
                self.counted = self.lines
            if self.covariance is not None:
                self.bench = stated_bench(self.together(), self.lines, self.view, self.bench)
            if len(self.lines) and self.method.options.waves:
                self._fit_with_waves()
        except KeyboardInterrupt as stop:
            self.reason = why_stopped(stop)
        if self.counted is not self.lines:
            self.covariance = None
        last = "bench of lines" if "fibres" in self.timings else "fibres"
        self.seconds = self.log.elapsed_s
        self.timings[last] = self.seconds - sum(self.timings.values())
        self.counters |= {"fibres": len(self.lines), "explained_by": "network"}
        if self.method.finds_section:
            self.counters["section"] = self.model.shape._asdict()
        if not len(self.lines):
            return
        found, residual, of_network = self.left()
        self.counters |= {"residual_of_network": of_network, "residual_of_fibres": residual}
        if residual > NO_CROWD_SHARE * of_network and self.is_crowd:
            self.is_left_alone = False
        self.is_noise_left = residual < of_network and is_explained(self.view.discrepancy(found))
        self.takes_lines = self.is_noise_left or residual < TAKEN_SHARE * of_network

    def shown_to(self, found: Reconstruction) -> tuple[CausticImage, CausticSimulator]:
        """The image as the bench of a result shows it, and that bench."""
        if not found.counters.get("bench", {}).get("is_kept"):
            lossy = self.told.scene.model_copy(update=found.counters.get("losses", {}))
            told = self.told.resimulation.simulator
            if lossy != told.scene:
                told = CausticSimulator(lossy, "lattice", device=self.method.device)
            return self.measured, told
        return seen_on(self.measured, self.numbers, self.bench, self.exposure), self.view.resimulation.simulator

    def _fit_with_all(self) -> None:
        """Lines with whatever else they may tell."""
        if self.method.takes_bench_as_told:
            fit_through_lens(self)
        else:
            if not self._asks_bench() and self._is_near():
                fit_with_place(self)
            fit_through_lens_or_with_light(self)
            if self._is_near():
                fit_with_lamp(self)
        if self._is_near() and self.method.options.losses is not False:
            fit_with_losses(self)
        if self._is_near():
            fit_with_section_or_bench(self, self._fit_with_bench)  # losses of light look like another section
        else:
            self._fit_with_bench()
        if self._is_near():
            view = self.view
            fit_through_blurring_lens(self)
            if self.view is not view:
                self._fit_with_bench()

    def _fit_with_bench(self) -> None:
        """Lines on the bench they tell."""
        if self._is_near() and not self.method.takes_bench_as_told:
            bench = self.bench
            fit_with_light(self)
            fit_with_gap(self)
            if self.bench is not bench:
                # Beside a Gaussian in place of the lens all numbers together take a base for the gap.
                fit_through_blurring_lens(self)
        if self._asks_bench():
            fit_with_bench(self)

    def _fit_by_noise(self) -> None:
        """Lines and bench by what is left of the image, where that is nothing but noise and tells clearly more."""
        if self.method.options.last_steps and not self.method.takes_bench_as_told:
            try:
                told = fit_by_noise(self)
            except torch.cuda.OutOfMemoryError:
                torch.cuda.empty_cache()
                self.counters["last_steps"] = "left out: they need a GPU with more memory"
                return
            if told is not None:
                self.counters["last_steps"] = dataclasses.asdict(told)

    def _looked_at_again(self) -> bool:
        """Lines searched for anew where they leave more than noise; whether others were found."""
        options, device = self.method.options, self.method.device.type
        is_other = look_again(self, options.looks_on(device))
        if options.evolves_on(device):
            is_other = evolve(self) or is_other
        return self._starts_elsewhere() or is_other

    def _starts_elsewhere(self) -> bool:
        """Lines searched for from other starts; whether any are better."""
        options, device = self.method.options, self.method.device.type
        return start_elsewhere(self, options.starts_on(device), options.evolves_on(device))

    def _asks_bench(self) -> bool:
        """Whether bench and lines are found together; on a bench that was found not where lines are far from right."""
        if self.is_elsewhere:
            return self._is_near()
        return self.method.finds_bench

    def _is_near(self) -> bool:
        """Whether losses of light show, and a wrong gap, which costs little of the image."""
        return self.view.is_near(self.lines)

    def _fit_with_waves(self) -> None:
        """Lines that vary along their way; their numbers' covariance is another one then, and not known."""
        self.waves = waves_of(self)
        if self.waves is not None:
            self.lines, self.covariance = self.waves.lines, None
            self.counters["waves"] = self.waves.record

    def may_be_pieces(self) -> bool:
        """Whether lines may be pieces of curves: they leave more than noise somewhere, and end where others begin."""
        return share_that_meet(self.lines) >= MEETING_SHARE and not self.view.is_settled(self.lines)

    def fit_curves(self, found: Reconstruction) -> bool:
        """Lines with corners and curves along the ridges of a result; whether they are taken."""
        before = sum(self.timings.values())
        try:
            self.curves = curves_on_their_bench(self, found)
        except KeyboardInterrupt as stop:
            self.reason = why_stopped(stop)
            return False
        self.timings["curves"] = self.log.elapsed_s - before
        if self.curves is None:
            return False
        if self.way_sigma is not None:
            self.bench = with_way(self.numbers, self.bench, self.way_sigma)
        self.counters |= {"fibres": len(self.curves.lines), "curves": self.curves.record, "explained_by": "fibres"}
        if self.method.finds_section:
            self.counters["section"] = self.model.shape._asdict()
        self.is_noise_left, self.takes_lines = self.view.is_relief_explained(self.relief()), True
        return True

    def result(self) -> Reconstruction:
        """Lines if they explain the image better than the network's relief, else that relief, refined."""
        return result_of(self)

    def relief(self) -> FloatArray:
        """Of the lines, shape [n, n] [m]."""
        made = self.curves or self.waves
        return self.view.relief(self.lines) if made is None else self.view.glass(made.heights)

    def left(self) -> tuple[FloatArray, float, float]:
        """Relief of the lines, and what it and the network's leave of the image."""
        found, left = self.relief(), self.view.resimulation
        return found, left(found).residual, left(self.view.glass(self.said.relief_m)).residual

    def residual_of(self, other: Reconstruction) -> float:
        """What another result leaves of the image, through the lens that lines told if they did."""
        is_here = other.heights_m.shape == (self.model.n, self.model.n)
        if self.view.camera.spread is None or not is_here:
            return other.residual
        return min(other.residual, self.view.resimulation(other.heights_m).residual)

    def fit_to(self, answer: Answer) -> None:
        """Lines on the bench that was told, or found without them, from what a network says."""
        options, told = self.method.options, self.model.shape
        most = options.most_lines if options.left_alone is None else min(options.most_lines, options.left_alone)
        heights, spread = answer.relief_m.cpu(), answer.spread_m.cpu()
        start = starting_lines(self.model, heights, spread, most, finds_section=self.method.finds_section)
        self.counters["lines_of_relief"] = len(start)
        if options.left_alone is not None and len(start) >= options.left_alone:
            self.model.shape, self.is_left_alone = told, True
            return
        self.is_left_alone = self.is_crowd = are_crowd(start)
        curved = Curved(self.model, start, heights, spread) if self._may_be_curved() else None
        if curved is None or not (curved.meet and curved()):
            # What the relief tells is the nearest of a few sections.
            self.moves_section = self.model.shape != told
            gives_way = None if curved is None or curved.meet else curved
            self.search(start, options.jumps, answer, is_first=True, gives_way=gives_way)
        if curved is not None and curved.are_rather:
            self.lines, self.model.shape, self.is_in_vain = self.lines[:0], told, True

    def _may_be_curved(self) -> bool:
        """Whether corners and curves are asked for amidst the search for straight lines, which takes a GPU no time."""
        options = self.method.options
        return options.looks_for_curves and options.max_time_s is None and self.method.device.type == "cpu"

    def search(
        self,
        start: torch.Tensor,
        jumps: int,
        answer: Answer | None = None,
        others: torch.Tensor | None = None,
        *,
        is_first: bool = False,
        evolves: bool = False,
        gives_way: Curved | None = None,
    ) -> None:
        """Lines searched for from others, which tell an answer or are from it; where nothing was before, its section.

        ``others`` of another search may be better in places. Where places stay wrong lines may evolve. Those that do
        not do well may give way to curves.
        """
        method, device, view = self.method, self.method.device, self.view
        answer = answer or self.said
        relief_m, spread_m = (each.to(device, torch.float32) for each in (answer.relief_m, answer.spread_m))
        search = LineSearch(
            view.scene,
            view.image,
            self.model,
            method.options.pixels_on(device.type, method.scene),
            jumps=jumps,
            iterations=self.iterations,
            finds_section=method.finds_section and is_first,
            moves_section=self.moves_section,
            answer=Answer(relief_m, spread_m, answer.most),
            others=others,
            view=view,
            report=self.note,
            camera=view.camera,
            evolves=evolves,
            gives_way=gives_way,
        )
        try:
            search.run(start)
        finally:
            self.lines = search.lines if len(search.lines) else start
            self.moves_section, self.is_in_vain = search.moves_section, search.is_in_vain and is_first

    def together(self, names: Collection[str] | None = None) -> BenchOfLines:
        """Finds bench and lines with the camera so far, by some of the bench's numbers or all."""
        numbers = self.numbers if names is None else self.numbers.only(names)
        few = usual_pixels(self.method.scene)
        about = numbers, self.told.image, self.model, few, self.view.camera
        return BenchOfLines(*about, with_section=self.moves_section, report=self.note)

    def on(self, bench: Bench, camera: ChannelCamera | None = None) -> LinesView:
        """The image on another bench, with a camera or that which lines tell there."""
        simulator = CausticSimulator(self.numbers.scene_of(bench.values), "lattice", device=self.method.device)
        image = seen_on(self.measured, self.numbers, bench, self.exposure)
        plain = Resimulation(simulator, image, self.exposure)
        if camera is None:
            camera = plain.found_camera(self.told.relief(self.lines), exactly=True)
            camera = with_spread_of(camera, self.view.camera)
        return LinesView(plain.through(camera), self.model)

    def note(self, loss: float) -> None:
        """Told after each evaluation; raises where the time is over."""
        self.log.note("fibres", None, objective=loss)
