"""What gap, base and index leave open of lines that explain an image with these as they were told.

An image of heights that are free says nothing of how far light goes from the relief to the screen: heights make up for
it. One of lines does, along the valley of :mod:`nets.reconstruct.fibres.bench.gap_of_lines`: where that was looked at,
and its least lies too near to be taken for another bench, it says that (n - 1) D is larger by the share t, give or
take sigma. What is believed of gap, base and index, w_k each, makes that share 0 give or take p; together it is m give
or take s,

    p^2 = sum_k (a_k w_k)^2,     1 / s^2 = 1 / p^2 + 1 / sigma^2,     m = t s^2 / sigma^2,

with a_k the share by which a unit of the number k adds to (n - 1) D. Heights stay those of the told bench, and are
uncertain by the mean square from there, m^2 + s^2: by what makes up for it in closed form
(:mod:`warp_caustics.found_bench.thin_relief`).
"""

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from nets.reconstruct.fibres.bench.bench_and_light import BEND_LIGHT, Bench
from nets.reconstruct.fibres.bench.gap_of_lines import by_number
from nets.reconstruct.with_bench import Told
from warp_caustics.found_bench.bench_numbers import BenchNumbers
from warp_caustics.found_bench.bench_uncertainty import careful_widths
from warp_caustics.found_bench.thin_relief import ThinRelief
from warp_caustics.types import FloatArray

AS_TOLD = 0.0025
"""Of (n - 1) D, by which lines say that light goes farther on a bench that is exactly as told, beside sigma: 0.1 to
0.15 % on own plates of a known section, 0.2 to 0.25 % on eight whose section was found with them (one H200)."""


@dataclass(frozen=True, eq=False)
class ToldBench:
    """What an image of lines tells of gap, base and index that are as told.

    Attributes:
        share: t, by which (n - 1) D is larger.
        sigma: its standard deviation.
        slopes: a_k, by name of the number, in one over its unit.
        response_m: by how much heights would be lower for a share of 1, to first order [m], shape [n, n].
    """

    share: float
    sigma: float
    slopes: Mapping[str, float]
    response_m: FloatArray

    @property
    def names(self) -> tuple[str, ...]:
        """Of the numbers."""
        return tuple(self.slopes)

    def known(self, widths: Mapping[str, float]) -> Told:
        """What is left open of the heights.

        Args:
            widths: standard deviations of these numbers before the image is seen, by name; 0 is exact.
        """
        before = {name: (slope * widths[name]) ** 2 for name, slope in self.slopes.items()}
        believed, told = sum(before.values()), self.sigma**2 + AS_TOLD**2
        mean, variance = self.share * believed / (believed + told), believed * told / (believed + told)
        # Each number is as certain as the others leave it.
        sigma = {name: widths[name] * math.sqrt(max(0.0, 1 - before[name] / (believed + told))) for name in self.slopes}
        return Told(math.hypot(mean, math.sqrt(variance)) * np.abs(self.response_m), sigma)


def told_bench(
    told: tuple[float, float] | None, numbers: BenchNumbers, bench: Bench, heights_m: FloatArray
) -> ToldBench | None:
    """What lines tell of gap, base and index that are as told; None where these were not asked, or are known exactly.

    Args:
        told: the share t and its standard deviation, by the search along the valley.
        numbers: of the bench as it is told, with what is looked for.
        bench: that was found, with gap, base and index as told.
        heights_m: of the lines, shape [n, n].
    """
    relief = ThinRelief.of(numbers.scene_of(bench.values))
    slopes = {p.name: by_number(numbers, bench, p) / relief.linear for p in numbers.parameters if p.name in BEND_LIGHT}
    if told is None or not slopes:
        return None
    return ToldBench(*told, slopes, relief.linear * heights_m / relief.bending(heights_m))


def with_way(numbers: BenchNumbers, bench: Bench, sigma: float) -> Bench:
    """A bench that knows how well those of gap, base and index are known that were moved to send light so far.

    Were the others as told, as well as a careful user knows them: sigma_k^2 = (sigma^2 + sum_j (a_j w_j)^2) / a_k^2.

    Args:
        numbers: of the bench as it is told.
        bench: that was found.
        sigma: standard deviation of how far light goes, relative to it.
    """
    far = ThinRelief.of(numbers.scene_of(bench.values)).linear
    slopes = {p.name: by_number(numbers, bench, p) / far for p in numbers.parameters if p.name in BEND_LIGHT}
    moved = [name for name in slopes if bench.values[name] != numbers.before[name]]
    widths = careful_widths(numbers.scene) | dict(numbers.told_widths)
    others = sum((slopes[name] * widths.get(name, 0.0)) ** 2 for name in slopes if name not in moved)
    known = {name: math.sqrt(sigma**2 + others) / abs(slopes[name]) for name in moved}
    return dataclasses.replace(bench, sigma={**bench.sigma, **known})
