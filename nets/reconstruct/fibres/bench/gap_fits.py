"""Gap, base and index of a bench on which lines were found, and what a run becomes by another bench.

Of all numbers these are the ones for which heights nearly make up: they are asked by themselves, along the valley that
heights leave (:mod:`nets.reconstruct.fibres.bench.gap_of_lines`), before all numbers together and after.
"""

import math
from collections.abc import Collection
from functools import partial
from typing import Protocol

from nets.reconstruct.fibres.bench.bench_and_light import BEND_LIGHT, Bench
from nets.reconstruct.fibres.bench.bench_of_lines import BenchOfLines
from nets.reconstruct.fibres.bench.camera_of_lines import Run as RunWithCamera
from nets.reconstruct.fibres.bench.camera_of_lines import fit_with_spread
from nets.reconstruct.fibres.bench.gap_of_lines import FARTHER, likeliest, on_other_bench, with_valley
from nets.reconstruct.fibres.bench.less_believed import (
    FAR,
    believed_at_first,
    gap_of_lines,
    is_other_glass,
    number_of_glass,
)
from nets.reconstruct.fibres.bench.line_posterior import CORRELATED_PX, JointCovariance
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
TELLING = (10.0, 100.0)
"""Times that an image tells more, one after the other: at last as much as if noise were all that is left of it."""
OF_FOUND, OF_TOLD = 1.0, 2.0
"""Standard deviations that light must go farther or less far than on a bench so far for noise to be asked: one of which
something was found, and one that is as told. Plates on benches exactly as told are 0.1 to 1.6 away, by the error of
their lattice; steps by noise helped plates that were 1.8 and 2.5 away, and harmed one that was 0.2 away."""
BELIEVED_BY = 4
"""Degrees of freedom of what is believed of a number that may be wrong."""
PULL = 23.0
"""Deviations that this pulls gap, base and index aside by, where it is as much as the noise."""


class Run(RunWithCamera, Protocol):
    """Lines of one image so far."""

    method: FibresOf
    told: LinesView
    hinted: float
    told_share: tuple[float, float] | None

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
    return usual + pulled_aside(run)


def pulled_aside(run: LinesRun) -> float:
    """Standard deviations by which a picture of another size, as it is simulated, pulls gap, base and index aside.

    0 where none is, or lines leave more than noise.
    """
    if not (run.numbers.is_picture and run.view.is_explained(run.lines)):
        return 0.0
    wrong = UNLIKE * math.exp(-UNLIKE_BLURRED * float(run.view.camera.blur.min()))
    return PULL * wrong / (run.view.noise * max(1.0, run.view.left(run.lines) or 1.0))


def least_gain(run: Run, squares: float) -> float:
    """Factor by which what is left falls where a bench tells so many squared standard deviations."""
    counted = float((run.view.discrepancy.whole.weight > 0).sum())
    return 1 - squares * CORRELATED_PX / (2 * max(counted, 1.0))


def unlikely(numbers: BenchNumbers, bench: Bench) -> float:
    """How unlikely gap, base and index of a bench are, in squares of deviations: -2 log p, 0 as they are told.

    By Student's distribution of :data:`BELIEVED_BY` degrees of freedom: what was told may be no measurement, and
    whether a number lies 20 or 30 widths away from there says little.

    Args:
        numbers: with what is believed of them.
        bench: as it was found.
    """
    free = [p for p in numbers.parameters if p.name in BEND_LIGHT]
    apart = [(bench.values[p.name] - numbers.before[p.name]) / p.prior for p in free]
    return sum((BELIEVED_BY + 1) * math.log1p(far**2 / BELIEVED_BY) for far in apart)


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


def is_open(run: Run) -> bool:
    """Whether noise may tell more of how far light goes than lines have told with a hundred pixels that err together.

    Not of a bench on which light goes as far as it does, within what those leave open, or twice that where nothing at
    all of the bench was found to be other: there all numbers would take most plates longer than all the rest. Steps by
    noise ask such a bench where all lines together hint at another one.
    """
    if run.told_share is None:
        return True
    share, sigma = run.told_share
    return abs(share) > (OF_TOLD if run.covariance is None else OF_FOUND) * sigma


def bends_other(run: Run) -> bool:
    """Whether gap, base or index were found to be other than told."""
    return any(run.bench.values.get(name) != run.numbers.before.get(name) for name in BEND_LIGHT)


def told_by(run: Run, together: BenchOfLines) -> JointCovariance:
    """The covariance of lines and bench that were found together, which is that of these numbers from now on."""
    covariance = together.covariance(run.lines, run.bench)
    run.covariance, run.counted, run.asked = covariance, run.lines, together.numbers.names
    return covariance


def _fit_with_lens(run: Run) -> None:
    """Lines with the lens they tell on another bench, where one was found: on the bench before it made up for that."""
    if run.view.camera.spread is not None:
        fit_with_spread(run)


def fit_with_gap(run: Run) -> None:
    """Lines with gap, base and index as one number, where that is significantly other than told.

    Lines that explain the image by it have to leave less than before, others as much less as is significant: the valley
    has told that already. A lens that is not found yet may leave 2.7 times the noise, of which 1 % more on the way of
    light takes 0.6 %; on the wrong bench that lens then made up for it, five own plates 2 to 6 um off that stated 1.8
    to 3.6.

    Raises:
        KeyboardInterrupt: the run's time is over; lines are as they were.
    """
    made: list[BenchOfLines] = []

    def fit() -> float:
        # Of another glass no index is as told.
        asked = deviations_asked(run, FARTHER if is_other_glass(run) else SIGNIFICANT)
        found = gap_of_lines(run, asked)
        if found is None:
            return 0.0
        together, nearer = found
        made.append(together)
        run.lines, run.bench = together.on(*nearer)
        run.view = run.on(run.bench)
        _fit_with_lens(run)
        search_again(run)
        return 1.0 if run.view.is_explained(run.lines) else least_gain(run, asked**2)

    if kept_if_less(run, fit):
        run.bench = made[0].with_sigma(run.bench, told_by(run, made[0]))


def fit_as_noise_tells(run: Run) -> None:
    """Lines and bench once more where they leave nothing but noise everywhere, by what that noise lets them tell.

    A search weighs what is believed of a bench as if a hundred pixels erred together, as they do where lines are not
    yet right. Where they are, and noise is each pixel's own, that pulls gap, base and index to what was told: a plate
    that left 1.6 deviations more than the true bench was by sixteen away from it, and 1.1 um off. Of twelve own plates
    whose bench was found five changed by it, 0.35, 1.57, 1.11, 0.63 and 0.20 um off before, 0.12, 0.80, 0.83, 0.42 and
    0.23 after. What is stated of lines and bench stays what a hundred leave open. A bench as told is asked only where
    lines nearly tell another one: that took about half of the time of plates on benches exactly as told (two cores).

    Raises:
        KeyboardInterrupt: the run's time is over; lines are those so far.
    """
    if not (bends_other(run) or is_open(run)):
        return
    for telling in TELLING:
        if not set(BEND_LIGHT) & set(run.asked) or not run.view.is_settled(run.lines) or is_other_glass(run):
            return

        def fit(telling: float = telling) -> float:
            together = run.together()
            together.correlated_px = CORRELATED_PX / telling
            run.lines, run.bench = with_valley(together, run.lines, run.bench)
            run.view = run.on(run.bench)
            _fit_with_lens(run)
            return 1.0

        if kept_if_less(run, fit):
            told_by(run, run.together())


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
    back by small steps: all begin again where each has its likely part. What they leave is judged with what is
    believed: a gap 50 um narrower behind a base 100 um thicker, of a glass whose index is 0.006 higher, left 0.03 %
    less than the true bench, and heights were 3 um off. Not of another glass, which is one number.

    Raises:
        KeyboardInterrupt: the run's time is over; lines are as they were.
    """
    if not bends_other(run) or is_other_glass(run):
        return

    usual = believed_at_first(run.numbers)

    def fit(start: Bench, numbers: BenchNumbers) -> float:
        scenes, was = (numbers.scene_of(each.values) for each in (run.bench, start)), unlikely(usual, run.bench)
        lines = run.lines if start is run.bench else run.model.clamped(on_other_bench(run.lines, *scenes))
        run.numbers = numbers
        run.lines, run.bench = with_valley(run.together(), lines, start)
        run.view = run.on(run.bench)
        _fit_with_lens(run)
        return least_gain(run, unlikely(usual, run.bench) - was)

    likely = likeliest(usual, run.bench)
    apart = [(run.bench.values[p.name] - likely.values[p.name]) / p.prior for p in usual.parameters]
    if kept_if_less(run, partial(fit, run.bench, run.numbers)):
        told_by(run, run.together())
    if math.hypot(*apart) > FAR and kept_if_less(run, partial(fit, likely, usual)):
        told_by(run, run.together())
