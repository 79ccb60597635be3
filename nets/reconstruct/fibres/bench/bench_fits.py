"""The bench that lines tell: the fewest of its numbers that explain an image.

Every number that is free has its share of an image's noise, and gap, base and index, which heights nearly make up for,
have most of it: of a picture that only lies aside by half a pixel all numbers together make 1.5 and 2.6 um of heights
on two own plates, by an index that is off by 0.0005 and 0.0025. A picture that lies aside, stray light or a lamp
nearby are common, and each is told by itself. So numbers are asked in turn, more of them only where those so far leave
more than noise.
"""

import dataclasses
from collections.abc import Collection, Sequence

import numpy as np
import scipy  # loads its parts when they are first used

from nets.reconstruct.fibres.bench.bench_and_light import BEND_LIGHT, SLANTS, Bench
from nets.reconstruct.fibres.bench.bench_of_lines import BenchOfLines
from nets.reconstruct.fibres.bench.gap_fits import (
    AS_WELL,
    BENCH_GAIN,
    Run,
    deviations_asked,
    fit_as_noise_tells,
    fit_with_every_number,
    fit_with_gap,
    fit_with_glass,
    least_gain,
    search_again,
    told_by,
)
from nets.reconstruct.fibres.bench.less_believed import fit_together, is_other_glass
from nets.reconstruct.fibres.bench.light_of_lines import losses_shown
from nets.reconstruct.fibres.bench.line_posterior import JointCovariance
from nets.reconstruct.fibres.bench.run_state import kept_if_less
from nets.reconstruct.fibres.bench.slant_or_shift import names_of_place, other_places
from warp_caustics.found_bench.bench_numbers import VERGENCE

LATER = (("dispersion_scale", *SLANTS, *BEND_LIGHT), BEND_LIGHT)
"""Numbers that are not asked at first, and not then."""
BENCH_ROUNDS = 2
"""In which bench and lines are found together, and lines then searched for on that bench."""
LEAST_LARGER_PX = 0.03
"""At the rim, by which a picture looks larger than it was told, for it to be asked whether it is."""
AGAIN = 2
"""Times that all numbers are asked once more while their score says so: gap, base and index go far in many steps."""
ASKING = 3.0
"""Standard deviations that the score of a bench must be away for it to be asked by lines that explain the image. Those
of a plate on the bench that was told have 1.2."""
BY_CHANCE = 0.05
"""How often numbers that are as told may look other than told."""
MOST = 0.5
"""Of what all numbers of a bench would explain, to second order, that fewer must to be asked before."""


def in_turn(names: Collection[str]) -> list[tuple[str, ...]]:
    """Numbers that are asked together, more each time, the last time all: what moves a picture, colours and slants too.

    A slant and what moves a picture are one to lines that lie beside their place: from there all numbers together end
    seven deviations away from a slant that is none.
    """
    last = len(names)
    asked = [tuple(name for name in names if name not in later) for later in (*LATER, ())]
    counts = [len(each) for each in asked]
    return [each for each, after in zip(asked, [*counts[1:], last + 1], strict=True) if 0 < len(each) < after]


def fit_with_bench(run: Run) -> None:
    """Lines with the bench they tell, by as few of its numbers as explain the image.

    Raises:
        KeyboardInterrupt: the run's time is over; lines are those of the last bench that explained it better.
    """
    together, left = None, in_turn(run.numbers.names)
    every, again, has_tried = left[-1:], AGAIN, False
    while left:
        names, left = asked_next(run, left)
        found = None if names is None else _fit_with_numbers(run, names)
        together = found or together
        if found is not None and not set(BEND_LIGHT) & set(names or ()) and is_other_glass(run):
            # Its index is asked before all numbers together, which end anywhere between.
            fit_with_gap(run)
        if found is not None and not has_tried:
            together, has_tried = _fit_with_other_size(run) or together, True
        if not left and again and found is not None and run.view.is_explained(run.lines):
            left, again = every, again - 1
    if run.view.is_explained(run.lines):
        if is_first(run):
            # Lines were already where all numbers together leave least.
            together = run.together()
            told_by(run, together)
        if together is not None:
            together = fit_with_other_place(run) or together
            _fit_with_fewer(run, together)
        if not set(BEND_LIGHT) & set(run.asked):
            fit_with_gap(run)
        fit_with_glass(run)
        fit_with_every_number(run)
        fit_as_noise_tells(run)


def fit_with_place(run: Run) -> None:
    """Lines with what moves a picture, and stray light, where they leave more than noise and most of it is by that.

    On few cores, where all numbers together take minutes: what bends light is asked there as one number
    (:func:`~nets.reconstruct.fibres.bench.gap_fits.fit_with_gap`), and the rest by noise once lines leave nothing else.
    Lines that lie aside with the picture leave more than noise on the bench as told, through any lens, and hide a gap:
    ten of them, 0.15 px aside, 7.8 um off.

    Raises:
        KeyboardInterrupt: the run's time is over; lines are those of the last bench that explained it better.
    """
    if run.view.is_settled(run.lines):
        return
    every = in_turn(run.numbers.names)
    first = every[0]
    evidence = run.together().evidence(run.lines, run.bench, every)
    if not set(BEND_LIGHT) & set(first) and evidence[0] >= max(ASKING**2, MOST * max(evidence)):
        _fit_with_numbers(run, first)


def is_first(run: Run) -> bool:
    """Whether a bench was found without lines, and these were not asked for it yet."""
    return run.is_elsewhere and run.covariance is None


def asked_next(run: Run, some: Sequence[tuple[str, ...]]) -> tuple[tuple[str, ...] | None, list[tuple[str, ...]]]:
    """Of sets of numbers the first that tells most of what all of them do, and those after it.

    None where lines explain the image, and no bench would explain clearly more of it.
    """
    if is_first(run):
        return some[0], list(some[1:])
    evidence = run.together().evidence(run.lines, run.bench, some)
    if run.view.is_explained(run.lines):
        if max(evidence) < ASKING**2:
            return None, []
        if run.numbers.is_picture:
            some, evidence = _that_are_simulated(run, some, evidence)
            if not some:
                return None, []
    first = next(k for k, each in enumerate(evidence) if each >= MOST * max(evidence))
    return some[first], list(some[first + 1 :])


def _that_are_simulated(
    run: Run, some: Sequence[tuple[str, ...]], evidence: Sequence[float]
) -> tuple[list[tuple[str, ...]], list[float]]:
    """Sets of numbers, and their evidence, that tell more than a picture of another size is simulated wrong by.

    Beside what the other sets tell.
    """
    is_fine = [bool(set(BEND_LIGHT) & set(names)) for names in some]
    plain = max((each for each, fine in zip(evidence, is_fine, strict=True) if not fine), default=0.0)
    least = plain + deviations_asked(run, ASKING) ** 2
    kept = [k for k, fine in enumerate(is_fine) if evidence[k] >= (least if fine else ASKING**2)]
    return [some[k] for k in kept], [evidence[k] for k in kept]


def _fit_with_numbers(run: Run, names: Collection[str]) -> BenchOfLines | None:
    """Lines with some numbers of the bench, where that explains the image better; what found them, or None."""
    has_valley, found = bool(set(BEND_LIGHT) & set(names)), None
    for _ in range(BENCH_ROUNDS if has_valley else 1):
        made: list[BenchOfLines] = []

        def fit(made: list[BenchOfLines] = made) -> float:
            run.numbers = dataclasses.replace(run.numbers, scene=losses_shown(run))
            was, was_explained = run.view.left(run.lines), run.view.is_explained(run.lines)
            made.append(fit_together(run, names))
            run.view = run.on(run.bench)
            now = run.view.left(run.lines)
            enough = _enough(run, was_explained)
            if not has_valley and (was is None or now is None or not now < enough * was):
                return 0.0
            search_again(run)
            return 1.0 if run.view.is_explained(run.lines) and not was_explained else enough

        if not kept_if_less(run, fit):
            break
        found = made[0]
        told_by(run, found)
        if run.view.is_explained(run.lines):
            break
    return found


def _enough(run: Run, is_explained: bool) -> float:
    """Factor by which what is left must fall for a bench to be kept, if with it lines still leave as much as before.

    Where they left hardly more than noise, by what the score must be for it to be asked.
    """
    if is_first(run):
        return 1.0
    return least_gain(run, ASKING**2) if is_explained else BENCH_GAIN


def _fit_with_other_size(run: Run) -> BenchOfLines | None:
    """Lines in a picture that is too large in place of one of a lamp nearby, or the reverse; what found them, or None.

    Where that leaves less. A picture that is brought back by resampling is off by more than what tells both apart, so
    that heights never saw it; what lines are compared with is brought back, too. And of three lines heights took a lamp
    at 1 m for a picture 0.2 % too large, which lines explained by light from 0.4 degrees aside.
    """
    vergence = run.bench.values.get(VERGENCE, 0.0)
    others = run.numbers.of_lamp() if run.numbers.is_picture else run.numbers.of_picture()
    if others is None or vergence <= 0:
        return None
    told = Bench.told(others)
    start = dataclasses.replace(told, values={**told.values, VERGENCE: vergence})
    larger = (run.numbers if run.numbers.is_picture else others).picture_size(start.values) - 1
    if larger * others.scene.image_pixels / 2 < LEAST_LARGER_PX:
        return None
    made: list[BenchOfLines] = []

    def fit() -> float:
        run.numbers = others
        run.view = run.on(start)
        made.append(run.together(in_turn(others.names)[0]))
        run.lines, run.bench = made[0](run.lines, start)
        run.view = run.on(run.bench)
        search_again(run)
        return 1.0

    if not kept_if_less(run, fit):
        return None
    told_by(run, made[0])
    is_done = run.view.is_explained(run.lines)
    return made[0] if is_done else _fit_with_numbers(run, others.names) or made[0]


def fit_with_other_place(run: Run) -> BenchOfLines | None:
    """Lines in light from aside in place of a picture that lies aside, or the reverse; what found them, or None.

    Where that explains clearly more, by what the score must be for a bench to be asked.
    """
    asked = {*run.asked, *names_of_place(run.numbers)}
    together = run.together([name for name in run.numbers.names if name in asked])
    for start in other_places(run.numbers, run.bench):

        def fit(start: Bench = start) -> float:
            run.lines, run.bench = together(run.lines, start)
            run.view = run.on(run.bench)
            return least_gain(run, ASKING**2) if run.view.is_explained(run.lines) else 0.0

        if kept_if_less(run, fit):
            told_by(run, together)
            return together
    return None


def _fit_with_fewer(run: Run, together: BenchOfLines) -> None:
    """Lines with the numbers that differ from what was told, and all others as told, where that explains the image."""
    assert run.covariance is not None
    names = together.numbers.names
    differ = differing(together, run.bench, run.covariance)
    if len(differ) == len(names):
        return
    told = {name: run.numbers.before[name] for name in names if name not in differ}
    fewer, sigma = run.together(differ), run.bench.sigma

    def fit() -> float:
        start = dataclasses.replace(run.bench, values={**run.bench.values, **told})
        run.lines, run.bench = fewer(run.lines, start)
        run.view = run.on(run.bench)
        return AS_WELL if run.view.is_explained(run.lines) else 0.0

    if kept_if_less(run, fit):
        told_by(run, fewer)
        run.bench = dataclasses.replace(run.bench, sigma={**sigma, **run.bench.sigma})


def differing(together: BenchOfLines, bench: Bench, covariance: JointCovariance) -> tuple[str, ...]:
    """Numbers of a bench that differ from what was told by more than they are known to, all others taken together.

    The Wald test of those that are as told: d^T C^-1 d of their differences d and covariance C stays below what chi^2
    of as many exceeds once in twenty times; they are gathered one by one, the least first.

    Args:
        together: of whose numbers.
        bench: that was found.
        covariance: of lines and bench.
    """
    numbers = together.numbers
    first = len(covariance.matrix) - together.n_beside
    widths = np.array([p.prior for p in numbers.parameters])
    apart = np.array([bench.values[name] - numbers.before[name] for name in numbers.names]) / widths
    block = covariance.matrix[first : first + len(widths), first : first + len(widths)]
    as_told: list[int] = []
    while len(as_told) < len(widths):
        tried = [[*as_told, k] for k in range(len(widths)) if k not in as_told]
        far = [float(apart[each] @ np.linalg.pinv(block[np.ix_(each, each)]) @ apart[each]) for each in tried]
        least = int(np.argmin(far))
        if far[least] > scipy.special.chdtri(len(tried[least]), BY_CHANCE):
            break
        as_told = tried[least]
    return tuple(name for k, name in enumerate(numbers.names) if k not in as_told)
