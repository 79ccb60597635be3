"""What lines and a bench that were found together leave open, as it is stated.

A bench is looked for with wide beliefs, so that it can be found far away, and in units in which a hundred pixels err
together. What is stated afterwards is another question:

- gap, base and index bend light by one factor, so that the image hardly says which of the three is other. Each is
  believed as of a careful user; if what was found of them lies S of their deviations away, all three are S times less
  well known (the Birge ratio, as in :mod:`warp_caustics.found_bench.care`): a gap that is found 58 um wider where 10 um
  are believed may as well be a base.
- what is not noise errs together, and noise does not. Where steps by noise alone ended
  (:mod:`~nets.reconstruct.fibres.bench.noise_posterior`) each pixel errs by itself, and what simulations lack comes
  beside it (:func:`left_open_by_simulation`).
- a bench on which lines leave more than noise may be none (:func:`left_open_by_unclear_bench`).
"""

import dataclasses
import math
from collections.abc import Collection, Mapping

import numpy as np
import torch

from nets.reconstruct.fibres.bench.bench_and_light import BEND_LIGHT, Bench
from nets.reconstruct.fibres.bench.line_posterior import CORRELATED_PX, SHAPE_WIDTHS, JointCovariance
from nets.reconstruct.fibres.image.lines_view import LinesView
from warp_caustics.found_bench.bench_numbers import BenchNumbers
from warp_caustics.found_bench.bench_record import SIGNIFICANT
from warp_caustics.found_bench.bench_uncertainty import DISPERSION, GLASS, INDEX_OFFSET, careful_widths
from warp_caustics.found_bench.thin_relief import ThinRelief
from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray

USUAL_NOISE = 0.02
"""Of a pixel, in units of the radiosity, at which a hundred were seen to err together; what is more is noise."""

SIMULATED_SHARE = 0.003
"""Of (n - 1) D, by which light goes farther there than on the true bench."""
UNCLEAR_SHARE = 1 / 3
"""Of the way to a bench that is not clear, that it may be off by. Of thirteen plates on ordinary and poor random
benches one was off by 1.2 and 3.1 times the way in two runs, the others by 0.02 to 0.5 of it, 0.18 and 0.25 in the
median; one that is off by all of it is three deviations away."""
NO_BENCH = 2.0
"""Times the noise, that lines leave, from which all of the way is open: they are wrong themselves. Three strands of a
meander told as six lines left 4.1 times that, told of light that goes 16.7 % farther, and were 16 % too low."""


def times_less_known(numbers: BenchNumbers, bench: Bench) -> float:
    """S, at least 1: how far gap, base and index are from what was told, in deviations of a careful user.

    Args:
        numbers: of the bench as it is told, with what is known of them.
        bench: that was found.
    """
    widths = careful_widths(numbers.scene) | {name: width for name, width in numbers.told_widths.items() if width > 0}
    apart = [(bench.values[name] - numbers.before[name]) / widths[name] for name in BEND_LIGHT if name in bench.values]
    return max(1.0, math.sqrt(sum(each**2 for each in apart)))


def stated_widths(numbers: BenchNumbers, bench: Bench) -> dict[str, float]:
    """Standard deviations of gap, base and index before the image is seen, by name; none that the user has told."""
    times, widths = times_less_known(numbers, bench), careful_widths(numbers.scene)
    stated = {name: times * widths[name] for name in BEND_LIGHT if name not in numbers.told_widths}
    colours = abs(bench.values.get(DISPERSION, 0.0) - numbers.before.get(DISPERSION, 0.0))
    if INDEX_OFFSET in stated and colours > SIGNIFICANT * bench.sigma.get(DISPERSION, math.inf):
        stated[INDEX_OFFSET] = math.hypot(stated[INDEX_OFFSET], GLASS * colours)
    return stated


def told_together(asked: Collection[str]) -> set[str]:
    """Numbers of a bench that the covariance of lines speaks of, which were asked: with one of gap, base and index all.

    They bend light by one factor: had a base been thicker, too, lines would have told of so much less gap, and heights
    would be the same. Where an image hardly tells of that factor, what is believed of the others would add a fifth.
    """
    return {*asked, *(BEND_LIGHT if set(BEND_LIGHT) & set(asked) else ())}


def left_open_by_hint(heights_m: FloatArray, scene: Scene, hinted: float) -> FloatArray:
    """How far heights would move on a bench that lines hint at, by two to four deviations, and do not tell [m], [n, n].

    Two of ten bases 0.1 mm thicker than told, three lines on each, were left as told: 5.5 um off, 1.2 stated.

    Args:
        heights_m: found, shape [n, n].
        scene: the bench.
        hinted: share of (n - 1) D by which light may go farther.
    """
    bench = ThinRelief.of(scene)
    return np.abs(hinted * bench.linear * heights_m / bench.bending(heights_m))


def left_open_by_simulation(heights_m: FloatArray, scene: Scene) -> FloatArray:
    """How far heights are off where steps by noise ended, by what simulations lack of lamp and lens [m], shape [n, n].

    Along the valley of gap and heights, where an image says least.

    Args:
        heights_m: found, shape [n, n].
        scene: the bench.
    """
    return left_open_by_hint(heights_m, scene, SIMULATED_SHARE)


def left_open_by_unclear_bench(heights_m: FloatArray, told: Scene, found: Scene, left: float) -> FloatArray:
    """A share of how far heights on the found bench are from those that show the same on the told one [m], [n, n].

    All of it where lines leave much more than noise.

    What lines leave beside noise, grain that is stronger than it looks or a lens that nobody told of, may have moved
    gap, base and index; under a lamp of half angle 1 degree, before that was asked for, by all of it: lines told of a
    gap 0.2 mm wider, and were 7 % too low.

    Args:
        heights_m: found, shape [n, n].
        told: the bench as it is told.
        found: the bench that lines told.
        left: discrepancy of the lines.
    """
    share = UNCLEAR_SHARE if left < NO_BENCH else 1.0
    bent = ThinRelief.of(found).bent(heights_m)
    return share * np.abs(ThinRelief.of(told).unbent(bent) - heights_m)


def independent_share(noise: float, left: float) -> float:
    """By how much more an image tells than if a hundred pixels erred together in all of what is left of it, 1 to 100.

    Args:
        noise: standard deviation of a pixel, in units of the radiosity.
        left: what lines leave of the image, in units of the noise.
    """
    whole = (max(left, 1.0) * noise) ** 2
    alone = max(0.0, noise**2 - USUAL_NOISE**2)
    return CORRELATED_PX * whole / (CORRELATED_PX * (whole - alone) + alone) if alone else 1.0


def as_stated(
    covariance: JointCovariance,
    lines: torch.Tensor,
    view: LinesView,
    numbers: BenchNumbers,
    asked: Collection[str],
    bench: Bench,
) -> JointCovariance:
    """A covariance of lines and bench as it is stated.

    Args:
        covariance: as lines and bench were found.
        lines: shape [L, 6] [m].
        view: the image on that bench.
        numbers: of the bench as it is told, with what is known of them.
        asked: names of those that were found with the lines.
        bench: that was found.
    """
    found = numbers.only(asked)
    n_beside = len(found.parameters) + len(bench.field)
    share = 1.0 if covariance.is_by_noise else independent_share(view.noise, view.left(lines) or 1.0)
    return as_believed(covariance, found, stated_widths(numbers, bench), n_beside, share)


def as_believed(
    covariance: JointCovariance, numbers: BenchNumbers, widths: Mapping[str, float], n_beside: int, share: float = 1.0
) -> JointCovariance:
    """A covariance of lines and bench with other beliefs: C'^-1 = k (C^-1 - B) + B', of which B is diagonal.

    Args:
        covariance: of lines and what is beside them, the numbers first.
        numbers: those that were asked, with the beliefs B that they were looked for with.
        widths: of B' where they are others, by name.
        n_beside: how many numbers are beside the lines.
        share: k, of :func:`independent_share`.
    """
    size = len(covariance.matrix)
    first = size - n_beside
    before = np.zeros(size)
    before[first:] = 1.0
    of_shape = first - len(covariance.places)
    before[of_shape:first] = [SHAPE_WIDTHS[place] ** -2 for place in covariance.places]
    after = before.copy()
    for number, p in enumerate(numbers.parameters):
        if p.name in widths:
            after[first + number] = (p.prior / widths[p.name]) ** 2
    # Lengths are micrometres, numbers of the bench widths: the inverse is that of the correlations.
    scale = np.sqrt(np.maximum(np.diag(covariance.matrix), 1e-30))
    information = np.linalg.inv(covariance.matrix / np.outer(scale, scale))
    changed = share * information + np.diag((after - share * before) * scale**2)
    return dataclasses.replace(covariance, matrix=np.linalg.inv(changed) * np.outer(scale, scale))
