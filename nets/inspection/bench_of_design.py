"""The bench that the lines of a design tell, where they do not explain the image on the one that was told.

As in ``fibres``: heights that are free make up for a wrong gap, lines of a known section do not. A design says the
section, and which lines there are.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import torch

from nets.reconstruct.fibres.bench.bench_and_light import SLANTS, Bench, seen_on
from nets.reconstruct.fibres.bench.bench_of_lines import BenchOfLines, numbers_of_lines
from nets.reconstruct.fibres.bench.camera_of_lines import with_spread_of
from nets.reconstruct.fibres.bench.line_posterior import JointCovariance, height_deviation
from nets.reconstruct.fibres.image.image_fit import ImageFit
from nets.reconstruct.fibres.image.lines_view import LinesView
from nets.reconstruct.fibres.trust.beliefs import as_stated
from nets.reconstruct.fibres.trust.stated_bench import stated_bench, stated_record
from nets.reconstruct.losses_of_light import effects_of, with_losses
from warp_caustics.errors import InputError
from warp_caustics.found_bench.bench_numbers import BenchNumbers
from warp_caustics.found_bench.bench_record import FoundBench
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.pyramid import usual_pixels
from warp_caustics.reconstruct.result import Resimulation
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator
from warp_caustics.types import FloatArray

GAIN = 0.9
"""A bench on which more than noise is left must lower the discrepancy by this factor to be kept."""

Fit = Callable[[torch.Tensor, LinesView], torch.Tensor]
"""Of lines, shape [L, 6] [m], and a view: lines that explain it better."""


@dataclass(frozen=True, eq=False)
class OnBench:
    """Lines on the bench that they tell.

    Attributes:
        lines: shape [L, 6] [m].
        view: the image on that bench.
        bench: its numbers and light.
        numbers: that it is told by.
        covariance: of lines and bench together (:mod:`nets.reconstruct.fibres.bench.line_posterior`).
        asked: names of the numbers in it.
    """

    lines: torch.Tensor
    view: LinesView
    bench: Bench
    numbers: BenchNumbers
    covariance: JointCovariance
    asked: tuple[str, ...]

    @property
    def deviation_m(self) -> FloatArray:
        """Of heights by what both leave open [m], shape [n, n]."""
        about = self.lines, self.view, self.numbers, self.asked, self.bench
        return height_deviation(self.view.model, self.lines, as_stated(self.covariance, *about))

    @property
    def record(self) -> FoundBench:
        """What was found, number by number."""
        return stated_record(self.numbers, self.bench)


def bench_of_design(
    lines: torch.Tensor,
    told: LinesView,
    measured: CausticImage,
    numbers: BenchNumbers,
    fit: Fit,
    report: Callable[[float], None],
) -> OnBench | None:
    """Lines and the bench on which they explain the image better; None where none is better by ``GAIN``.

    Args:
        lines: that explain the image best on the told bench, shape [L, 6] [m].
        told: the image there.
        measured: the image as it was measured.
        numbers: of the told bench.
        fit: fits lines to a view.
        report: called after each evaluation with its loss; may raise.
    """
    numbers = numbers_of_lines(BenchNumbers.of(numbers.scene, numbers.told_widths))
    best, at, view = None, Bench.told(numbers), told
    upright = tuple(name for name in numbers.names if name not in SLANTS)
    for names in (upright, upright, numbers.names):
        image, camera = seen_on(told.image, numbers, at), view.camera
        lossy = with_losses(view.scene, partial(_misfit, image, lines, told, camera), both=True)
        lost = dataclasses.replace(numbers, scene=numbers.scene.model_copy(update=effects_of(lossy)))
        pixels = usual_pixels(told.scene)
        together = BenchOfLines(lost.only(names), told.image, told.model, pixels, camera, report=report)
        moved, there = together(lines, at)
        try:
            found = _on(there, lost, moved, told, measured, camera)
        except InputError:
            continue
        moved = fit(moved, found)
        was, now = view.left(lines), found.left(moved)
        is_done = found.is_explained(moved)
        if was is None or now is None or not now < (1.0 if is_done else GAIN) * was:
            continue
        lines, view, at, numbers = moved, found, there, lost
        best = OnBench(lines, view, at, numbers, together.covariance(lines, at), together.numbers.names)
        if is_done:
            break
    if best is None:
        return None
    every = BenchOfLines(
        best.numbers, told.image, told.model, usual_pixels(told.scene), best.view.camera, report=report
    )
    return dataclasses.replace(best, bench=stated_bench(every, best.lines, best.view, best.bench))


def _misfit(image: CausticImage, lines: torch.Tensor, told: LinesView, camera: ChannelCamera, scene: Scene) -> float:
    """Of lines in a scene, at its exposure."""
    fit = ImageFit(scene, image, told.model, scene.image_pixels, camera=camera)
    return fit.loss(told.model.heights(lines), at_exposure=True)


def _on(
    bench: Bench,
    numbers: BenchNumbers,
    lines: torch.Tensor,
    told: LinesView,
    measured: CausticImage,
    known: ChannelCamera,
) -> LinesView:
    """The image on another bench, with the camera that lines tell there, and the point spread that is known of it."""
    device, exposure = told.resimulation.simulator.device, told.resimulation.exposure
    simulator = CausticSimulator(numbers.scene_of(bench.values), "lattice", device=device)
    plain = Resimulation(simulator, seen_on(measured, numbers, bench, exposure), exposure)
    camera = with_spread_of(plain.found_camera(told.relief(lines)), known)
    return LinesView(plain.through(camera), told.model)
