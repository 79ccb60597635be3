"""The section of lines that explain an image nearly, asked once more.

A section must explain clearly more than the usual one to be taken before lines are right, for lines that are wrong
explain a little more with a section of their own. Once they are right it is told to a thousandth: cosines of a power of
0.975 and 1.025 passed for the usual one, left 1.14 times the noise, and were 1.1 um off where 0.1 was stated.

A bench on which light goes farther looks nearly like another section: cosines behind a base 30 and 100 um thicker than
told passed for a power of 0.996, and were 2.6 and 3.4 um off on eleven plates. So both are asked, each by itself, and
that which leaves less of the image has the first word.
"""

from collections.abc import Callable
from typing import Protocol

import torch

from nets.reconstruct.fibres.bench.run_state import LinesRun, RunState
from nets.reconstruct.fibres.fibres_of import FibresOf
from nets.reconstruct.fibres.image.image_fit import ImageFit
from nets.reconstruct.fibres.image.one_wavelength import OneWavelength
from warp_caustics.reconstruct.pyramid import usual_pixels

ITERATIONS = 15
"""Of L-BFGS at few pixels, of lines alone and then with their section."""
FACTOR = 0.99
"""The misfit at few pixels must fall by this factor: to 0.71 and 0.74 where the power is 0.025 off, to 0.9999 on four
plates of the usual section, one of them with 10 % of noise."""
AS_WELL = 1.0005
"""What a bench may leave of the image, of what a section leaves, to be believed in its place: it is one number, a
section three."""


class Run(LinesRun, Protocol):
    """Lines of one image so far."""

    method: FibresOf

    def search(self, start: torch.Tensor, jumps: int) -> None:
        """Lines searched for from others, shape [L, 6] [m]."""

    def note(self, loss: float) -> None:
        """Told after each evaluation; may raise."""


def fit_with_section_or_bench(run: Run, fit_bench: Callable[[], None]) -> None:
    """Lines with a section of their own, on another bench, or both, as the image has it.

    Args:
        run: whose lines nearly explain the image.
        fit_bench: finds the bench they tell.

    Raises:
        KeyboardInterrupt: the run's time is over; lines are those of the section, of the bench, or of before.
    """
    before = RunState.of(run)
    fit_with_section(run)
    if run.moves_section == before.moves_section:
        fit_bench()
        return
    by_section, left = RunState.of(run), run.view.left(run.lines)
    before.put(run)
    fit_bench()
    left_by_bench = run.view.left(run.lines)
    if run.bench is not before.bench and (left_by_bench or 0.0) <= AS_WELL * (left or 0.0):
        fit_with_section(run)
        return
    by_section.put(run)
    fit_bench()


def fit_with_section(run: Run) -> None:
    """Lines whose section moves, where that is significantly another than the usual one.

    Raises:
        KeyboardInterrupt: the run's time is over; lines are as they were.
    """
    if run.moves_section or not run.method.finds_section or not len(run.lines):
        return
    fit, given = _few(run), (run.lines, run.model.shape)
    fit.correct_at(run.model.heights(run.lines))
    is_better = False
    try:
        plain = fit.descend(run.lines, ITERATIONS)
        moved = fit.descend(plain.lines, ITERATIONS, with_section=True)
        if moved.loss < FACTOR * plain.loss:
            was, run.moves_section = run.view.left(given[0]), True
            run.search(moved.lines, 0)
            now = run.view.left(run.lines)
            is_better = was is not None and now is not None and now < was
    finally:
        if not is_better:
            run.lines, run.model.shape = given
            run.moves_section = False


def _few(run: Run) -> ImageFit:
    """The misfit at few pixels of the clearest wavelength, through the camera that was found."""
    size, one = usual_pixels(run.view.scene), OneWavelength.clearest(run.view.image, run.view.scene, run.view.camera)
    return one.fit(run.model, size, report=run.note, metric=one.metric(run.model, size // 2))
