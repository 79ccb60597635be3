"""How well the numbers of a bench are known that lines told, as it is stated.

A bench is found by as few numbers as explain an image. Each of these then is as certain as if all others were exactly
as told: gaps that had a base and an index 20 um and 0.0007 off beside them were told to 1 um, and were 13 um off;
pictures that lay aside because light was slanted to 0.6 um, and 7 um off. What is stated of them is what lines leave
open of all numbers together, gap, base and index believed as of :mod:`~nets.reconstruct.fibres.trust.beliefs`.

Stray light is told beside a lens whose halos pass for it; what they may take or give is in no covariance of lines and
bench, and stated with it: behind 2 % of speckle 0.15 %, where lines leave 0.1 open.
"""

import dataclasses
import math

import torch

from nets.reconstruct.fibres.bench.bench_and_light import Bench, bench_record
from nets.reconstruct.fibres.bench.bench_of_lines import BenchOfLines
from nets.reconstruct.fibres.image.lines_view import LinesView
from nets.reconstruct.fibres.trust.beliefs import as_stated, stated_widths
from warp_caustics.found_bench.bench_numbers import AMBIENT, BenchNumbers
from warp_caustics.found_bench.bench_record import FoundBench


def stated_bench(together: BenchOfLines, lines: torch.Tensor, view: LinesView, bench: Bench) -> Bench:
    """A bench that knows how well its numbers are known, those that were not asked as they were.

    Args:
        together: finds lines with all numbers of the bench.
        lines: that were found, shape [L, 6] [m].
        view: the image on the bench.
        bench: that was found with them.
    """
    numbers = together.numbers
    covariance = as_stated(together.covariance(lines, bench), lines, view, numbers, numbers.names, bench)
    known = dict(together.with_sigma(bench, covariance).sigma)
    spread = view.camera.spread
    if spread is not None and AMBIENT in known:
        known[AMBIENT] = math.hypot(known[AMBIENT], spread.stray)
    return dataclasses.replace(bench, sigma={name: known[name] for name in bench.sigma})


def stated_record(numbers: BenchNumbers, bench: Bench) -> FoundBench:
    """What was found, number by number, beside what was believed of gap, base and index.

    Args:
        numbers: of the bench as it is told, with what is known of them.
        bench: of :func:`stated_bench`.
    """
    widths = stated_widths(numbers, bench)
    believed = [dataclasses.replace(p, prior=widths.get(p.name, p.prior)) for p in numbers.parameters]
    return bench_record(dataclasses.replace(numbers, parameters=tuple(believed)), bench)
