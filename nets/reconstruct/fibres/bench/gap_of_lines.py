"""How far light goes from the relief to the screen, as lines tell it: a search along the one valley that heights leave.

Light that meets a thin relief at x lands at y = x + grad F(h), F(h) = (n - 1) (D h + h^2 / (2 n)), D = d / n + g / n_o
(:mod:`warp_caustics.found_bench.thin_relief`): base d, gap g and index n act on heights as one factor. Heights with
F_D'(h') = F_D(h) show nearly the same on a bench of another D, and lines on a wrong bench explain an image nearly as
well as on the right one; only the section, the same for lines of all heights, and caustics, where light paths cross,
tell the benches apart. All numbers together (:mod:`nets.reconstruct.fibres.bench.bench_of_lines`) do not get along such
a valley, which is long, narrow and bent: a step of the gap alone costs much, and what makes up for it is known only to
first order. Here D takes a step, heights follow in closed form, the lines alone descend, and what they leave of the
image is a function of D: followed downhill by growing steps, then a parabola.

Of gap, base and index that is moved of which least is believed, as far as it goes, then the next: which of them it was
the image tells hardly, and their joint covariance says so.
"""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch

from nets.reconstruct.fibres.bench.bench_and_light import BEND_LIGHT, Bench
from nets.reconstruct.fibres.bench.bench_of_lines import BenchOfLines
from nets.reconstruct.fibres.bench.least_of_valley import bracketed, vertex
from nets.reconstruct.fibres.bench.line_posterior import misfit_weight
from nets.reconstruct.fibres.image.image_fit import ImageFit
from nets.reconstruct.fibres.image.one_wavelength import clearest_wavelength
from warp_caustics.errors import InputError
from warp_caustics.found_bench.bench_numbers import BenchNumbers
from warp_caustics.found_bench.bench_record import SIGNIFICANT
from warp_caustics.found_bench.thin_relief import ThinRelief
from warp_caustics.prints.line_shape import Shape
from warp_caustics.prints.model import HEIGHT
from warp_caustics.scene import Scene
from warp_caustics.setup.parameter import Parameter

FIRST_STEP = 0.0125
"""Of (n - 1) D, relative to it: heights as much lower, 4 to 10 um under usual lines, at the edge of what matters. Half
a usual prior width of the gap, 25 um behind 3 mm of glass."""
ASKING_ITERATIONS = 5
"""Of L-BFGS a step to either side, which tell whether to look at all: on seven plates what they leave is within 0.5 %
of what twice as many do, but for one whose lines had not come down on the bench they were on."""
ITERATIONS = 10
"""Of L-BFGS at each D, from the lines at its neighbour: heights that followed are nearly right."""
LEFT_OVER = 1e-4
"""Of a step that no number of the bench need take: that of rounding."""
MOST_SHARED = 5
"""Times that what is left of a way is shared between gap, base and index."""
MOST_MOVES = 4
"""Of the last parabola, until its middle is its least."""
VALLEYS, FARTHER = 2, 1.0
"""How often the valley is followed where the bench is found anyhow, and from how many standard deviations on."""
HINTING = 2.0
"""Standard deviations from which on another bench is hinted at, though not taken."""
LEAST_WIDTH = FIRST_STEP / 2
"""Of half the last parabola: what lines leave is uneven by what their descents have not reached, and the curvature of
a narrower one would be that of noise."""


@dataclass(frozen=True)
class Trial:
    """Lines after a descent on one bench.

    Attributes:
        share: by which (n - 1) D is larger than on the bench that the search started from.
        bench: with that.
        lines: shape [L, 6] [m].
        shape: of their section.
        loss: misfit, and what is believed of the bench, in its units.
    """

    share: float
    bench: Bench
    lines: torch.Tensor
    shape: Shape
    loss: float


def on_other_bench(lines: torch.Tensor, here: Scene, there: Scene) -> torch.Tensor:
    """Lines whose crowns send light on another bench where they did on this one, F_there(h') = F_here(h).

    Args:
        lines: shape [L, 6] [m].
        here: their bench.
        there: the other.
    """
    heights = ThinRelief.of(there).unbent(ThinRelief.of(here).bent(lines[:, HEIGHT].numpy()))
    moved = lines.clone()
    moved[:, HEIGHT] = torch.from_numpy(heights)
    return moved


def by_number(numbers: BenchNumbers, bench: Bench, parameter: Parameter) -> float:
    """Derivative of (n - 1) D by a number of the bench [m / unit], by a step as wide as what is believed of it.

    To the side with more room, and no farther than the number's range: beliefs may have been widened beyond it.
    """
    at = bench.values[parameter.name]
    is_up = parameter.high - at >= min(parameter.prior, at - parameter.low)
    end = min(at + parameter.prior, parameter.high) if is_up else max(at - parameter.prior, parameter.low)
    there = ThinRelief.of(numbers.scene_of({**bench.values, parameter.name: end}))
    return (there.linear - ThinRelief.of(numbers.scene_of(bench.values)).linear) / (end - at)


def along(numbers: BenchNumbers, bench: Bench, share: float, first: str | None = None) -> Bench:
    """The bench on which (n - 1) D is larger by a share.

    The number of gap, base and index that is believed least moves, and where it is at its limit the next.

    Args:
        numbers: that are looked for.
        bench: where to start.
        share: of (n - 1) D.
        first: name of the number that moves before the others; None for that which is believed least.

    Raises:
        InputError: no such bench within the limits of the numbers.
    """
    free = [p for p in numbers.parameters if p.name in BEND_LIGHT]
    slopes = {p.name: by_number(numbers, bench, p) for p in free}
    linear = ThinRelief.of(numbers.scene_of(bench.values)).linear
    rest, values = share * linear, dict(bench.values)
    for p in sorted(free, key=lambda p: (p.name != first, -p.prior * abs(slopes[p.name]))):
        if abs(rest) <= LEFT_OVER * abs(share) * linear:
            break
        was = values[p.name]
        values[p.name] = min(max(was + rest / slopes[p.name], p.low), p.high)
        rest -= (values[p.name] - was) * slopes[p.name]
    if abs(rest) > LEFT_OVER * abs(share) * linear:
        raise InputError(f"no bench on which light goes {1 + share:.3f} times as far")
    return Bench(values, bench.field, bench.sigma)


def likeliest(numbers: BenchNumbers, bench: Bench) -> Bench:
    """The bench on which light goes as far, with gap, base and index by what is believed of them.

    Each takes the part of the way at which the sum of the squares of their deviations from what was told is least,
    d_k = a_k w_k^2 / sum_j (a_j w_j)^2 of it, with a_k its slope and w_k its width; one at its limit stays there.

    Args:
        numbers: that are looked for.
        bench: where to start.
    """
    there = ThinRelief.of(numbers.scene_of(bench.values)).linear
    free = [p for p in numbers.parameters if p.name in BEND_LIGHT]
    at = dataclasses.replace(bench, values={**bench.values, **{p.name: numbers.before[p.name] for p in free}})
    for _ in range(MOST_SHARED):
        rest = there - ThinRelief.of(numbers.scene_of(at.values)).linear
        slopes = {p.name: by_number(numbers, at, p) for p in free}
        whole = sum((slopes[p.name] * p.prior) ** 2 for p in free)
        if not free or abs(rest) <= LEFT_OVER * there:
            break
        moved = {p.name: at.values[p.name] + rest * slopes[p.name] * p.prior**2 / whole for p in free}
        at = dataclasses.replace(at, values={**at.values, **numbers.within(moved)})
        free = [p for p in free if at.values[p.name] == moved[p.name]]
    return at


class GapOfLines:
    """Finds the bench along the valley: on a GPU at all wavelengths, on a CPU at that which shows most.

    Args:
        together: misfits of the image on benches; of its numbers gap, base and index are moved.
    """

    def __init__(self, together: BenchOfLines):
        self.together, self.numbers, self.model = together, together.numbers, together.model
        # All wavelengths tell as much more as there are of them; a core takes as many times as long for them.
        is_quick = self.model.device.type == "cuda"
        self._channel = None if is_quick else clearest_wavelength(together.image, together.numbers.scene)
        self.hinted = 0.0
        """Share of (n - 1) D by which the last search would have gone, had that been significant."""
        self.told: tuple[float, float] | None = None
        """Share of (n - 1) D, and its standard deviation, by which light goes farther than on the bench the last search
        started from, by a parabola; None where it told nothing."""

    def fit_on(self, bench: Bench) -> ImageFit:
        """The misfit on a bench: all pixels, since fewer look like another bench.

        Raises:
            InputError: values that make no bench.
        """
        return self.together.fit_on(bench, self._channel)

    def __call__(
        self, lines: torch.Tensor, bench: Bench, *, significant: float = SIGNIFICANT
    ) -> tuple[torch.Tensor, Bench] | None:
        """Lines, shape [L, 6] [m], and the bench that they tell; None where that is the one they are on.

        Args:
            lines: that explain the image, or nearly, shape [L, 6] [m].
            bench: on which they do.
            significant: standard deviations that another one must be away.
        """
        if not len(lines) or not any(p.name in BEND_LIGHT for p in self.numbers.parameters):
            return None
        shape = self.model.shape
        try:
            found = self._found(lines, bench, significant)
        except BaseException:
            self.model.shape = shape
            raise
        self.model.shape = shape if found is None else found.shape
        return None if found is None else (found.lines, found.bench)

    def settled(self, lines: torch.Tensor, bench: Bench, missing: torch.Tensor | None) -> float:
        """Misfit that lines, shape [L, 6] [m], and their section come down to on a bench.

        Args:
            lines: where they descend from.
            bench: which stays.
            missing: of the image, for its lattice, of lines that show nearly the same.
        """
        fit, shape = self.fit_on(bench), self.model.shape
        fit.correct_by(missing)
        found = fit.descend(lines, ITERATIONS, with_section=self.together.with_section)
        self.model.shape = shape
        return found.loss

    def _found(self, lines: torch.Tensor, bench: Bench, significant: float) -> Trial | None:
        """The least of the valley, where it lies significantly elsewhere."""
        fit, heights = self.fit_on(bench), self.model.heights(lines)
        fit.correct_at(heights)
        loss = fit.loss(heights)
        weight, asked = misfit_weight(fit, loss, self.together.correlated_px), min(significant, HINTING)
        search = _Valley(self, bench, weight, fit.missing)
        given = Trial(0.0, bench, lines, self.model.shape, loss + search.believed(bench))
        # Lines have descended here, on all wavelengths; those that descend on one a step away seldom leave less.
        sides = [search.trial(given, side * FIRST_STEP, ASKING_ITERATIONS) for side in (-1, 1)]
        if min(side.loss for side in sides) >= given.loss:
            # Sides that have descended and lines that have not make a valley look flat.
            self.told = told_between(sides, search.trial(given, 0.0, ASKING_ITERATIONS), weight)
            if not _is_aside(self.told, asked):
                return None
        start = search.trial(given, 0.0)
        best = min((start, *sides), key=lambda each: each.loss)
        if best is not start:
            three = bracketed(search.trial, start, best)
            if three is None:
                return None
            left, middle, right = three
        else:
            self.told = told_between(sides, start, weight)
            if not _is_aside(self.told, asked):
                return None
            (left, right), middle = sides, start
        if not math.isfinite(left.loss + right.loss):
            return None
        least, curvature = vertex(left, middle, right)
        if curvature <= 0:
            return None
        middle = min(middle, search.trial(middle, least), key=lambda each: each.loss)
        left, middle, right = search.around(middle, max(LEAST_WIDTH, math.sqrt(weight / curvature)))
        least, curvature = vertex(left, middle, right)
        if curvature > 0:
            self.told = least, math.sqrt(weight / curvature)
        if curvature <= 0 or abs(least) <= asked * math.sqrt(weight / curvature):
            return None
        # Descents on the way have moved lines that were not yet right: the bench they came from has its share of that.
        gain = min(search.trial(middle, 0.0).loss, start.loss) - middle.loss
        if gain <= weight * asked**2 / 2:
            return None
        far = min(abs(least) / math.sqrt(weight / curvature), math.sqrt(2 * gain / weight))
        if far <= significant:
            self.hinted = least
            return None
        return search.moved(middle, least)


def told_between(sides: Sequence[Trial], here: Trial, weight: float) -> tuple[float, float] | None:
    """Share at which the valley is least between two trials, and its standard deviation; None where they do not tell.

    Gaps 10 um wider left 4 and 6 deviations less a third of a step away, and more a step away.

    Args:
        sides: of which neither leaves less than the one in the middle.
        here: that.
        weight: of :func:`~nets.reconstruct.fibres.bench.line_posterior.misfit_weight`.
    """
    left, right = sides
    if not math.isfinite(left.loss + right.loss):
        return None
    least, curvature = vertex(left, here, right)
    return (least, math.sqrt(weight / curvature)) if curvature > 0 else None


def _is_aside(told: tuple[float, float] | None, deviations: float) -> bool:
    """Whether a least lies more than so many deviations aside."""
    return told is not None and abs(told[0]) > deviations * told[1]


def with_valley(together: BenchOfLines, lines: torch.Tensor, bench: Bench) -> tuple[torch.Tensor, Bench]:
    """Lines, shape [L, 6] [m], and the bench they tell: all numbers together, then along the valley, and together.

    Args:
        together: misfits of the image on benches.
        lines: that explain the image, or nearly, shape [L, 6] [m].
        bench: on which they do.
    """
    lines, bench = together(lines, bench)
    for _ in range(VALLEYS):
        found = GapOfLines(together)(lines, bench, significant=FARTHER)
        if found is None:
            break
        lines, bench = together(*found)
    return lines, bench


class _Valley:
    """Trials along the valley from one bench."""

    def __init__(self, method: GapOfLines, bench: Bench, weight: float, missing: torch.Tensor | None = None):
        self.method, self.numbers, self.bench, self.weight = method, method.numbers, bench, weight
        # All along the valley the image is nearly the same, and with it what its lattice is off by.
        self._missing = missing
        self._free = [p for p in self.numbers.parameters if p.name in BEND_LIGHT]

    def believed(self, bench: Bench) -> float:
        """What is believed of gap, base and index, in units of the loss."""
        apart = [(bench.values[p.name] - self.numbers.before[p.name]) / p.prior for p in self._free]
        return self.weight / 2 * sum(each**2 for each in apart)

    def moved(self, near: Trial, share: float) -> Trial:
        """Lines in closed form on another bench; their loss is not known.

        Raises:
            InputError: no such bench.
        """
        bench = along(self.numbers, self.bench, share)
        here, there = (self.numbers.scene_of(each.values) for each in (near.bench, bench))
        lines = self.method.model.clamped(on_other_bench(near.lines, here, there))
        return Trial(share, bench, lines, near.shape, math.inf)

    def trial(self, near: Trial, share: float, iterations: int = ITERATIONS) -> Trial:
        """After a descent from lines on a bench nearby; where there is no bench with an infinite loss."""
        model = self.method.model
        try:
            start = self.moved(near, share)
            fit = self.method.fit_on(start.bench)
            fit.correct_by(self._missing)
            model.shape = start.shape
            found = fit.descend(start.lines, iterations, with_section=self.method.together.with_section)
        except InputError:
            model.shape = near.shape
            return dataclasses.replace(near, share=share, loss=math.inf)
        return Trial(share, start.bench, found.lines, model.shape, found.loss + self.believed(start.bench))

    def around(self, middle: Trial, width: float) -> tuple[Trial, Trial, Trial]:
        """Three trials a width apart, the middle one the least unless that takes too many moves."""
        left, right = (self.trial(middle, middle.share + side * width) for side in (-1, 1))
        for _ in range(MOST_MOVES):
            if left.loss < min(middle.loss, right.loss):
                left, middle, right = self.trial(left, left.share - width), left, middle
            elif right.loss < middle.loss:
                left, middle, right = middle, right, self.trial(right, right.share + width)
            else:
                break
        return left, middle, right
