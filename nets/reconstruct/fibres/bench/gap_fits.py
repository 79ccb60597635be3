"""Gap, base and index of a bench on which lines were found, and what a run becomes by another bench.

Of all numbers these are the ones for which heights nearly make up: they are asked by themselves, along the valley that
heights leave (:mod:`nets.reconstruct.fibres.bench.gap_of_lines`), before all numbers together and after.
"""

import math
from collections.abc import Collection
from functools import partial
from typing import Protocol

import torch

from nets.reconstruct.fibres.bench.bench_and_light import BEND_LIGHT, Bench
from nets.reconstruct.fibres.bench.bench_of_lines import BenchOfLines
from nets.reconstruct.fibres.bench.gap_of_lines import FARTHER, likeliest, on_other_bench, with_valley
from nets.reconstruct.fibres.bench.less_believed import (
    FAR,
    believed_at_first,
    gap_of_lines,
    is_other_glass,
    number_of_glass,
)
from nets.reconstruct.fibres.bench.line_posterior import JointCovariance
from nets.reconstruct.fibres.bench.run_state import LinesRun, kept_if_less
from nets.reconstruct.fibres.fibres_of import FibresOf
from nets.reconstruct.fibres.image.lines_view import LinesView
from warp_caustics.found_bench.bench_numbers import BenchNumbers
from warp_caustics.found_bench.bench_record import SIGNIFICANT

BENCH_GAIN = 0.9
"""A bench on which more than noise is left must lower the discrepancy by this factor to be kept."""
AS_WELL = 1.002
"""The same of fewer numbers, which explain an image as well."""
UNLIKE, UNLIKE_BLURRED = 2e-3, 2.0
"""Of flat light, that a picture of another size is simulated wrong by, root mean square, and the power by which that
falls per pixel of blur: 0.15 to 0.23 % without, half behind 0.35 px, a fifth behind 0.8."""
PULL = 23.0
"""Deviations that this pulls gap, base and index aside by, where it is as much as the noise."""


class Run(LinesRun, Protocol):
    """Lines of one image so far."""

    method: FibresOf
    told: LinesView
    hinted: float
    told_share: tuple[float, float] | None

    def on(self, bench: Bench) -> LinesView:
        """The image on a bench, with the camera that the lines tell there."""

    def search(self, start: torch.Tensor, jumps: int) -> None:
        """Lines searched for from others, shape [L, 6] [m]."""

    def together(self, names: Collection[str] | None = None) -> BenchOfLines:
        """Finds bench and lines with the camera so far, by some of the bench's numbers or all."""


def deviations_asked(run: Run, usual: float) -> float:
    """Standard deviations that gap, base and index must be away to be asked.

    More than usual of lines that explain a picture of another size, by what that is simulated wrong by. Light that
    went to so many pixels is simulated as such, but for a rest that is resampled
    (:class:`~warp_caustics.reconstruct.seen_camera.point_spread.FineLight`), and what was measured is brought back:
    three lines that left nothing but noise of a picture 1 % too large asked for a gap 27 um wider, by 133 squared
    deviations, when that made half of their noise. Where they were never asked for, lines on ordinary random benches,
    whose pictures looked 0.03 to 0.4 % too large, kept a gap 80 um too narrow, and were 10 to 30 um off.

    Args:
        run: lines so far.
        usual: deviations.
    """
    if not (run.numbers.is_picture and run.view.is_explained(run.lines)):
        return usual
    wrong = UNLIKE * math.exp(-UNLIKE_BLURRED * float(run.view.camera.blur.min()))
    return usual + PULL * wrong / (run.view.noise * max(1.0, run.view.left(run.lines) or 1.0))


def search_again(run: Run) -> None:
    """Lines searched for once more where they leave more than noise, in the mean or somewhere; the better are kept.

    On another bench a line may end elsewhere that did not, or went beyond the plate, on the one it was found on: one of
    eleven whose end lay outside left noise in the mean, and by 0.4 % of uneven light all others were 1 um off.
    """
    if run.view.is_settled(run.lines):
        return
    kept, was = (run.lines, run.model.shape), run.view.left(run.lines)
    run.search(run.lines, 1)
    now = run.view.left(run.lines)
    if was is not None and now is not None and now >= was:
        run.lines, run.model.shape = kept


def told_by(run: Run, together: BenchOfLines) -> JointCovariance:
    """The covariance of lines and bench that were found together, which is that of these numbers from now on."""
    covariance = together.covariance(run.lines, run.bench)
    run.covariance, run.counted, run.asked = covariance, run.lines, together.numbers.names
    return covariance


def fit_with_gap(run: Run) -> None:
    """Lines with gap, base and index as one number, where that is significantly other than told.

    Raises:
        KeyboardInterrupt: the run's time is over; lines are as they were.
    """
    made: list[BenchOfLines] = []

    def fit() -> float:
        # Of another glass no index is as told.
        found = gap_of_lines(run, deviations_asked(run, FARTHER if is_other_glass(run) else SIGNIFICANT))
        if found is None:
            return 0.0
        together, nearer = found
        made.append(together)
        run.lines, run.bench = together.on(*nearer)
        run.view = run.on(run.bench)
        search_again(run)
        return 1.0 if run.view.is_explained(run.lines) else BENCH_GAIN

    if kept_if_less(run, fit):
        run.bench = made[0].with_sigma(run.bench, told_by(run, made[0]))


def fit_with_glass(run: Run) -> None:
    """Lines with another index, where gap or base had made up for it before the glass's dispersion was found.

    Raises:
        KeyboardInterrupt: the run's time is over; lines are as they were.
    """
    made: list[BenchOfLines] = []

    def fit() -> float:
        found = number_of_glass(run)
        if found is None:
            return 0.0
        together, (run.lines, run.bench) = found
        made.append(together)
        run.view = run.on(run.bench)
        return AS_WELL if run.view.is_explained(run.lines) else BENCH_GAIN

    if kept_if_less(run, fit):
        run.bench = made[0].with_sigma(run.bench, told_by(run, made[0]))


def fit_with_every_number(run: Run) -> None:
    """Lines with all numbers once more, where gap, base or index were found to be other than told.

    The fewest numbers are what differs on a bench that is nearly as told. Where it is not, what is believed of all
    others as they were told holds gap, base and index back: on own plates whose light went 67 um farther they ended 53
    and 45 um away, 3 and 1.5 um off. And a base that was taken for all of it, 140 um thicker than told, does not come
    back by small steps: all begin again where each has its likely part. Not of another glass, which is one number.

    Raises:
        KeyboardInterrupt: the run's time is over; lines are as they were.
    """
    before = run.numbers.before
    if all(run.bench.values.get(name) == before.get(name) for name in BEND_LIGHT) or is_other_glass(run):
        return

    def fit(start: Bench, numbers: BenchNumbers) -> float:
        scenes = (numbers.scene_of(each.values) for each in (run.bench, start))
        lines = run.lines if start is run.bench else run.model.clamped(on_other_bench(run.lines, *scenes))
        run.numbers = numbers
        run.lines, run.bench = with_valley(run.together(), lines, start)
        run.view = run.on(run.bench)
        return 1.0

    usual = believed_at_first(run.numbers)
    likely = likeliest(usual, run.bench)
    apart = [(run.bench.values[p.name] - likely.values[p.name]) / p.prior for p in usual.parameters]
    if kept_if_less(run, partial(fit, run.bench, run.numbers)):
        told_by(run, run.together())
    if math.hypot(*apart) > FAR and kept_if_less(run, partial(fit, likely, usual)):
        told_by(run, run.together())
