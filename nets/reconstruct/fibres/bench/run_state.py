"""What the lines of an image and their bench are so far, so that a change that explains no more can be taken back."""

from collections.abc import Callable, Collection
from typing import NamedTuple, Protocol

import torch

from nets.reconstruct.fibres.bench.bench_and_light import Bench
from nets.reconstruct.fibres.bench.line_posterior import JointCovariance
from nets.reconstruct.fibres.image.lines_view import LinesView
from warp_caustics.found_bench.bench_numbers import BenchNumbers
from warp_caustics.prints.line_shape import Shape
from warp_caustics.prints.model import LineModel


class LinesRun(Protocol):
    """Lines of one image so far: what changes.

    Attributes:
        model: prints lines with the section so far.
        lines: shape [L, 6] [m].
        view: the image on the bench, through the camera.
        moves_section: whether lines move their section, too.
        bench: that the lines tell.
        numbers: of the bench as it is told, with what is believed of them.
        is_elsewhere: whether the bench was found without lines.
        covariance: of lines and bench, of the lines ``counted`` and the numbers ``asked``; None where it is not known.
    """

    model: LineModel
    lines: torch.Tensor
    view: LinesView
    moves_section: bool
    bench: Bench
    numbers: BenchNumbers
    is_elsewhere: bool
    covariance: JointCovariance | None
    counted: torch.Tensor
    asked: Collection[str]


class RunState(NamedTuple):
    """All of that at one time."""

    lines: torch.Tensor
    view: LinesView
    shape: Shape
    moves_section: bool
    bench: Bench
    numbers: BenchNumbers
    is_elsewhere: bool
    covariance: JointCovariance | None
    counted: torch.Tensor
    asked: Collection[str]

    @classmethod
    def of(cls, run: LinesRun) -> "RunState":
        about = run.bench, run.numbers, run.is_elsewhere, run.covariance, run.counted, run.asked
        return cls(run.lines, run.view, run.model.shape, run.moves_section, *about)

    def put(self, run: LinesRun) -> None:
        """Changes a run back to it."""
        run.lines, run.view, run.model.shape, run.moves_section = self[:4]
        run.bench, run.numbers, run.is_elsewhere, run.covariance, run.counted, run.asked = self[4:]

    @property
    def left(self) -> float | None:
        """Discrepancy of the lines in the whole image; None if the noise of the image is unknown.

        With the section of that time: the run's own may have moved since, and lines of another one leave more.
        """
        model, now = self.view.model, self.view.model.shape
        model.shape = self.shape
        try:
            return self.view.left(self.lines)
        finally:
            model.shape = now


def kept_if_less(run: LinesRun, fit: Callable[[], float]) -> bool:
    """Change a run, and change it back unless what is left of the image falls below so much of what was, as is told."""
    kept, is_kept = RunState.of(run), False
    try:
        enough = fit()
        was, now = kept.left, run.view.left(run.lines)
        is_kept = was is not None and now is not None and now < enough * was
    finally:
        if not is_kept:
            kept.put(run)
    return is_kept
