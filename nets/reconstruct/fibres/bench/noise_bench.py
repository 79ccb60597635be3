"""Derivatives of what is shown by the numbers of a bench, for steps by an image's noise.

Each takes two pictures on fine pixels, whatever lines there are. Steps go along the valley of gap and heights, where
what is shown hardly changes, and so hardly do these. Where pictures take seconds those of the first place serve for
all (the chord method; Kelley, Iterative Methods for Linear and Nonlinear Equations, section 5.4), and for the look
before, whether a bench is hinted at. Derivatives by lines, of which only light that a line moves is traced, are taken
anew.
"""

import dataclasses
from collections.abc import Callable, Iterator

import torch

from nets.reconstruct.fibres.bench.bench_and_light import Bench
from warp_caustics.calibration.view_model import difference_ends
from warp_caustics.found_bench.bench_model import STEP
from warp_caustics.found_bench.bench_numbers import AMBIENT, BenchNumbers
from warp_caustics.reconstruct.pyramid import in_units_of_radiosity
from warp_caustics.setup.optical import optical_steps

BENCH_STEP = 6 * STEP
"""Differences by which derivatives are taken. Light that moves by less than a fine pixel changes what these fold back:
beside sixteen lines by a gap 15 % of the derivative. Of differences several times as large that is 5 %, and what is
left to third order is 2 to 7."""


class ByBench:
    """What is shown, by each number of a bench in the width of what is believed of it.

    Args:
        renews: whether derivatives are taken anew at each place; else those of the first serve for all.
    """

    def __init__(self, renews: bool):
        self.renews = renews
        self._first: dict[str, torch.Tensor] = {}

    def __call__(
        self,
        numbers: BenchNumbers,
        bench: Bench,
        pixels: int,
        shown: Callable[[Bench], torch.Tensor],
        by_stray_light: torch.Tensor | None,
    ) -> Iterator[torch.Tensor]:
        """Derivatives, each of shape [n_w, m, m], in the numbers' order.

        Args:
            numbers: of the bench as it is told.
            bench: where derivatives are taken.
            pixels: along the image.
            shown: by the relief there on a bench.
            by_stray_light: derivative by stray light, which needs no picture; None if that is none of the numbers.
        """
        steps = optical_steps(in_units_of_radiosity(numbers.scene_of(bench.values), pixels))
        for parameter in numbers.parameters:
            name = parameter.name
            if name == AMBIENT and by_stray_light is not None:
                yield parameter.prior * by_stray_light
                continue
            change = self._first.get(name)
            if change is None:
                between = difference_ends(parameter, bench.values[name], BENCH_STEP * steps[name])
                values = ({**bench.values, name: end} for end in between)
                low, high = (shown(dataclasses.replace(bench, values=each)) for each in values)
                change = parameter.prior * (high - low) / (between[1] - between[0])
                if not self.renews:
                    self._first[name] = change
            yield change
