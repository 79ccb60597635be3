"""Numbers of a bench that were found far from what was told, beyond what is believed of them.

A belief that is normal pulls the harder the farther an image says that a number lies; but one that lies ten deviations
away shows that what was told is no measurement of it. On a base 1 mm thicker than told, and behind a gap 1 mm wider,
three lines found a third of the way, 11 and 17 um off, and stated 0.6 and 1.1. So where numbers that were found lie
beyond ``FAR`` deviations, what was believed of them is widened to where they are (the Birge ratio once more, see
:mod:`warp_caustics.found_bench.care`), and they are asked again; and since gap, base and index are not one factor any
more so far away, it is asked which of them it was.

Only where lines then leave nothing but noise, or much less: a lamp of half angle 1 degree, before it was asked for
(:mod:`nets.reconstruct.fibres.bench.lamp_of_lines`), left 1.24 times that, and drove a gap that is believed less twice
as far.
"""

import dataclasses
import math
from collections.abc import Collection
from typing import Protocol

import torch

from nets.reconstruct.fibres.bench.bench_and_light import BEND_LIGHT, Bench
from nets.reconstruct.fibres.bench.bench_of_lines import BenchOfLines
from nets.reconstruct.fibres.bench.gap_of_lines import (
    FARTHER,
    GapOfLines,
    along,
    by_number,
    on_other_bench,
    with_valley,
)
from nets.reconstruct.fibres.bench.line_posterior import misfit_weight
from nets.reconstruct.fibres.image.lines_view import LinesView
from warp_caustics.errors import InputError
from warp_caustics.found_bench.bench_numbers import BenchNumbers
from warp_caustics.found_bench.bench_record import SIGNIFICANT
from warp_caustics.found_bench.bench_uncertainty import DISPERSION, GLASS, INDEX_OFFSET
from warp_caustics.found_bench.thin_relief import ThinRelief
from warp_caustics.prints.model import LineModel

FAR = 2.0
"""Deviations from what was told, of gap, base and index together and of every other number by itself, up to which a
belief stays as it is."""
CLEAN = 1.15
"""Discrepancy up to which lines leave nothing that could pass for another bench: 0.92 to 1.09 on six benches far away,
1.24 to 1.29 under lamps of 1 and 2 degrees that passed for lenses."""
MUCH_LESS = 0.8
"""Of what lines leave on the bench nearer by, below which they may leave more than that: plates that are crowded."""
BETTER = 3.0
"""Standard deviations by which one of gap, base and index must leave less than that which is believed least."""
LEAST_HINT = 0.01
"""Share of (n - 1) D below which a hint is none: a careful user leaves 0.5 %, and of six own plates whose section was
found with the lines, on the bench that was told, the valley is least 0.3 to 0.9 % below it."""
MIXED = 0.03
"""Of dispersion, which channels that mix pass for: 3 % of each neighbour's light for 3.5 % less of it, where noise
alone tells half a per cent. Other glasses have a fifth more or less, plastics a quarter."""
MOST_TIMES = 4
"""That beliefs are widened: from a base 1 mm thicker, 33 of its deviations, three were needed."""


class Run(Protocol):
    """Lines of one image so far."""

    model: LineModel
    lines: torch.Tensor
    bench: Bench
    numbers: BenchNumbers
    hinted: float
    """Share of (n - 1) D by which light goes farther than on the bench, as lines hint."""
    told_share: tuple[float, float] | None
    """The same, significant or not, and its standard deviation; None where lines were not asked."""

    def on(self, bench: Bench) -> LinesView:
        """The image on a bench, with the camera that the lines tell there."""

    def together(self, names: Collection[str] | None = None) -> BenchOfLines:
        """Finds bench and lines with the camera so far, by some of the bench's numbers or all."""


def less_believed(numbers: BenchNumbers, bench: Bench) -> BenchNumbers:
    """Numbers with wider beliefs where a bench lies far beyond them; the same object where it lies nowhere so far.

    What the user says of a number stays.

    Args:
        numbers: of the bench as it is told, with what is believed of them.
        bench: that was found.
    """
    apart = {p.name: abs(bench.values[p.name] - numbers.before[p.name]) / p.prior for p in numbers.parameters}
    together = math.sqrt(sum(far**2 for name, far in apart.items() if name in BEND_LIGHT))
    wider = {}
    for p in numbers.parameters:
        far = together if p.name in BEND_LIGHT and apart[p.name] >= 1 else apart[p.name]
        if far > FAR and p.name not in numbers.told_widths:
            wider[p.name] = far * p.prior
    colours = abs(bench.values.get(DISPERSION, 0.0) - numbers.before.get(DISPERSION, 0.0))
    if DISPERSION in wider and INDEX_OFFSET not in numbers.told_widths:
        # It is another glass.
        wider[INDEX_OFFSET] = max(GLASS * colours, wider.get(INDEX_OFFSET, 0.0))
    parameters = tuple(
        dataclasses.replace(p, prior=wider[p.name]) if wider.get(p.name, 0.0) > p.prior else p
        for p in numbers.parameters
    )
    return numbers if parameters == numbers.parameters else dataclasses.replace(numbers, parameters=parameters)


def gap_of_lines(run: Run, significant: float = SIGNIFICANT) -> tuple[BenchOfLines, tuple[torch.Tensor, Bench]] | None:
    """What found it, lines, and the bench with another gap, base or index that they tell; None where that is as told.

    Lines and bench of the run stay; its beliefs become those that led there, its section that of the lines.

    Args:
        run: whose lines nearly explain the image.
        significant: standard deviations that another one must be away.
    """
    before = run.numbers
    run.numbers = less_believed(before, run.bench)
    numbers, together = run.numbers, run.together()
    valley = GapOfLines(together)
    found = valley(run.lines, run.bench, significant=significant)
    run.hinted = valley.hinted if abs(valley.hinted) > LEAST_HINT else 0.0
    run.told_share = valley.told
    if found is None:
        run.numbers = before
        return None
    narrow = together, found
    shape = run.model.shape
    for _ in range(MOST_TIMES):
        less = less_believed(run.numbers, found[1])
        if less is run.numbers:
            break
        run.numbers = less
        together = run.together()
        found = GapOfLines(together)(*found, significant=FARTHER) or found
    if run.numbers is numbers:
        return narrow
    together, found = by_one_number(run, together.numbers.names, *found, numbers)
    found = together.on(*found)
    if _is_clear(run, *found, _left(run, *narrow[1])):
        return together, found
    run.numbers, run.model.shape = numbers, shape
    return narrow


def believed_at_first(numbers: BenchNumbers) -> BenchNumbers:
    """Numbers with what was believed of them before any was found far away."""
    every = BenchNumbers.of(numbers.scene, numbers.told_widths)
    usual = {p.name: p.prior for p in (*every.parameters, *every.not_told)}
    parameters = tuple(dataclasses.replace(p, prior=usual[p.name]) for p in numbers.parameters)
    return dataclasses.replace(numbers, parameters=parameters)


def is_other_glass(run: Run) -> bool:
    """Whether its dispersion was found to be another, by more than channels that mix, and its index is not known."""
    numbers, bench = run.numbers, run.bench
    if not {DISPERSION, INDEX_OFFSET} <= set(numbers.names) or INDEX_OFFSET in numbers.told_widths:
        return False
    colours = abs(bench.values[DISPERSION] - numbers.before[DISPERSION])
    return colours > SIGNIFICANT * math.hypot(bench.sigma.get(DISPERSION, math.inf), MIXED)


def number_of_glass(run: Run) -> tuple[BenchOfLines, tuple[torch.Tensor, Bench]] | None:
    """What found it, lines, and the bench with another index, where gap or base had made up for another glass.

    That its dispersion is another shows last, when light already goes as far as it has to; what sent it there was
    believed least only before. None where no other glass was found, or its index is not what leaves least; the run
    stays then, but for what it believes if there is one.

    Args:
        run: whose lines explain the image on its bench.
    """
    before, bench = run.numbers, run.bench
    moved = {name for name in BEND_LIGHT if bench.values.get(name) != before.before.get(name)}
    if not moved - {INDEX_OFFSET} or not is_other_glass(run):
        return None
    as_told = {**bench.values, **{name: before.before[name] for name in moved}}
    run.numbers = less_believed(believed_at_first(before), dataclasses.replace(bench, values=as_told))
    together, found = by_one_number(run, before.names, run.lines, bench, run.numbers, INDEX_OFFSET)
    if found[1] is bench:
        run.numbers = before
        return None
    found = together.on(*found)
    found = GapOfLines(together)(*found, significant=FARTHER) or found
    return together, together.on(*found)


def _least_believed(numbers: BenchNumbers, bench: Bench) -> str:
    """Which of gap, base and index may send light farthest by what is believed of it."""
    free = [p for p in numbers.parameters if p.name in BEND_LIGHT]
    return max(free, key=lambda p: p.prior * abs(by_number(numbers, bench, p))).name


def fit_together(run: Run, names: Collection[str]) -> BenchOfLines:
    """Lines with some numbers of the bench, put into the run; what found them.

    Args:
        run: whose lines nearly explain the image on its bench.
        names: of the numbers.
    """
    run.numbers = less_believed(run.numbers, run.bench)
    run.hinted = 0.0 if set(BEND_LIGHT) & set(names) else run.hinted
    numbers, together = run.numbers, run.together(names)
    run.lines, run.bench = with_valley(together, run.lines, run.bench)
    narrow, shape = (together, run.lines, run.bench), run.model.shape
    for _ in range(MOST_TIMES):
        less = less_believed(run.numbers, run.bench)
        if less is run.numbers:
            break
        run.numbers = less
        together = run.together(names)
        run.lines, run.bench = with_valley(together, run.lines, run.bench)
    if not set(BEND_LIGHT) & set(names) & widened(numbers, run.numbers):
        return together
    together, found = by_one_number(run, names, run.lines, run.bench, numbers)
    run.lines, run.bench = together(*found)
    if not _is_clear(run, run.lines, run.bench, _left(run, *narrow[1:])):
        together, run.lines, run.bench = narrow
        run.numbers, run.model.shape = numbers, shape
    return together


def _is_clear(run: Run, lines: torch.Tensor, bench: Bench, narrow_left: float | None) -> bool:
    """Whether lines leave nothing on a bench that could pass for another one, or much less than on the one nearer by.

    Args:
        run: with the beliefs of that bench.
        lines: shape [L, 6] [m].
        bench: far from the told one.
        narrow_left: discrepancy on the one nearer by.
    """
    left = _left(run, lines, bench)
    return left is not None and (left <= CLEAN or (narrow_left is not None and left < MUCH_LESS * narrow_left))


def _left(run: Run, lines: torch.Tensor, bench: Bench) -> float | None:
    """Discrepancy of lines, shape [L, 6] [m], on a bench."""
    view = run.on(bench)
    return view.discrepancy(view.relief(lines))


def widened(before: BenchNumbers, after: BenchNumbers) -> set[str]:
    """Names of the numbers of which less is believed than before."""
    was = {p.name: p.prior for p in before.parameters}
    return {p.name for p in after.parameters if p.prior > was[p.name]}


def by_one_number(
    run: Run,
    names: Collection[str],
    lines: torch.Tensor,
    bench: Bench,
    believed: BenchNumbers,
    first: str | None = None,
) -> tuple[BenchOfLines, tuple[torch.Tensor, Bench]]:
    """Lines, shape [L, 6] [m], on the bench that leaves least of those on which one number sends light so far.

    Gap, base and index are one factor where light is bent little. Far from what was told they are not: a base 1 mm
    thicker that is taken for a gap is found 6 % of that way too near, and leaves more of the image, by four deviations.

    Args:
        run: whose beliefs become those of that bench; its section, too.
        names: of the numbers that are asked.
        lines: that explain the image, shape [L, 6] [m].
        bench: far from the told one, on which they do.
        believed: numbers with what was believed before; of the one that is taken less is believed now.
        first: name of the number that others must leave less than; None: that which is believed least, alone or not.

    Returns:
        What found them; and lines and bench.
    """
    together, numbers, model = run.together(names), run.numbers, run.model
    asked = [name for name in BEND_LIGHT if name in together.numbers.names]
    told = dataclasses.replace(bench, values={**bench.values, **{name: numbers.before[name] for name in asked}})
    far = ThinRelief.of(numbers.scene_of(bench.values)).linear / ThinRelief.of(numbers.scene_of(told.values)).linear
    fit = GapOfLines(together).fit_on(bench)
    fit.correct_at(model.heights(lines))
    least = GapOfLines(together).settled(lines, bench, fit.missing)
    better = misfit_weight(fit, least) * BETTER**2 / 2
    other_than_told = {name for name in asked if bench.values[name] != told.values[name]}
    is_first = other_than_told == {first} if first else _least_believed(numbers, bench) in other_than_told
    first = first or _least_believed(numbers, bench)
    found = [(least - is_first * better, together, lines, bench, model.shape, numbers)]
    shape = model.shape
    for name in asked:
        if other_than_told == {name}:
            continue
        model.shape = shape
        try:
            other = along(together.numbers, told, far - 1, name)
            run.numbers = less_believed(believed, other)
            valley = GapOfLines(run.together(names))
            moved = model.clamped(on_other_bench(lines, *(numbers.scene_of(each.values) for each in (bench, other))))
            nearer, other = valley(moved, other, significant=FARTHER) or (moved, other)
            left = valley.settled(nearer, other, fit.missing) - (name == first and not is_first) * better
        except InputError:
            continue
        found.append((left, valley.together, nearer, other, model.shape, run.numbers))
    _, together, lines, bench, model.shape, run.numbers = min(found, key=lambda each: each[0])
    return together, (lines, bench)
