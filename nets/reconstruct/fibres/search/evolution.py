"""A line, or ends that meet, found at a place without a start: by differential evolution of many.

A thin, high line on top of others is told by two low, wide ones, and nothing that a network or a ridge proposes is near
enough for a descent to arrive: its light lands far from it, and lines next to it get along without it. Descents arrive
from within 0.2 mm of its ends. So a place that stays wrong has 150 lines spread over it, of all widths and heights,
which evolve (Storn and Price 1997) as the image likes them: thousands of simulations, at few pixels.
"""

import math
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
import scipy  # loads its parts when they are first used
import torch

from nets.reconstruct.fibres.image.image_fit import ImageFit
from nets.reconstruct.fibres.search.clearing import Place
from warp_caustics.prints.model import LineModel
from warp_caustics.types import FloatArray

REACH_M = 3.5e-3
"""Of both ends from the place, along x and y."""
WIDTHS_M = (2e-4, 3e-3)
HEIGHTS_M = (3e-5, 2.5e-3)
"""In which lines begin; what evolves stays within."""
POPULATION = 25
"""Lines, or ways to set up ends, that evolve for each number that is looked for."""
GENERATIONS = 30
END_GENERATIONS = 20
STRETCHED_M = -5e-3, 5e-3
"""Of ends that move along their lines."""
FOUND = 3
"""Lines that are found, at most, of the last generation."""
APART_M = 3e-4
"""Ends of which they lie apart, at least."""


def evolved(fit: ImageFit, kept: torch.Tensor, place: Place, seed: int = 0) -> torch.Tensor:
    """Lines at a place that the image likes best with all others as they are, shape [K, 6] [m], the best first.

    On a plate of which a line 0.4 mm wide and 1.3 mm high was told by two low ones, which left it 16 um off, three
    evolutions ended 0.15, 0.18 and 0.44 mm from it.

    Args:
        fit: judges.
        kept: all other lines, shape [L, 6] [m].
        place: centre of where ends are looked for, x and y [m].
        seed: of the random numbers.
    """
    (x, y), model = place, fit.model
    ranges = [(at - REACH_M, at + REACH_M) for at in (x, y, x, y)]
    ranges += [(math.log(low), math.log(high)) for low, high in (WIDTHS_M, HEIGHTS_M)]
    last = _evolution(partial(_misfits, fit, kept), ranges, GENERATIONS, seed)
    order = np.argsort(last.population_energies)
    return _distinct(_lines(model, last.population[order]))


def evolved_ends(fit: ImageFit, lines: torch.Tensor, ends: Sequence[tuple[int, int]], seed: int = 0) -> torch.Tensor:
    """Lines of which some have ends where the image likes them best together, shape [L, 6] [m].

    Where five lines ended in one place some were 2 mm too long and some 1 mm too short: each is held by the others, and
    by short lines that make up for what these do not tell. Two own plates were 8.5 and 7.5 um off for that, and 3.3 and
    0.3 um after their ends had evolved.

    Args:
        fit: judges.
        lines: shape [L, 6] [m].
        ends: lines and columns of the ends that move along their lines, one of each line.
        seed: of the random numbers.
    """
    model, moving = fit.model, [k for k, _ in ends]
    outward = [_outward(lines[k], column) for k, column in ends]
    kept = lines[[k for k in range(len(lines)) if k not in moving]]

    def moved(by_m: FloatArray) -> torch.Tensor:
        """Lines with ends so much farther out, shape [K, E, 6] [m] of [K, E]."""
        versions = lines[moving].repeat(len(by_m), 1, 1)
        for number, (_, column) in enumerate(ends):
            versions[:, number, column : column + 2] += torch.from_numpy(by_m[:, number, None]) * outward[number]
        return model.clamped(versions)

    def misfits(by_m: FloatArray) -> FloatArray:
        found = fit.losses_with_each(kept, moved(np.atleast_2d(by_m.T)))
        if fit.report is not None:
            fit.report(min(found))
        return np.asarray(found)

    last = _evolution(misfits, [STRETCHED_M] * len(ends), END_GENERATIONS, seed)
    best = lines.clone()
    best[moving] = moved(last.x[None])[0]
    return best


def _outward(line: torch.Tensor, column: int) -> torch.Tensor:
    """Direction in which a line [6] goes on at its end in column 0 or 2, shape [2]."""
    way = line[column : column + 2] - line[2 - column : 4 - column]
    outward: torch.Tensor = way / way.norm().clamp_min(1e-12)
    return outward


def _evolution(
    misfits: Callable[[FloatArray], FloatArray], ranges: Sequence[tuple[float, float]], generations: int, seed: int
) -> scipy.optimize.OptimizeResult:
    """What numbers within ranges evolve to; misfits are of numbers of shape [N, K]."""
    return scipy.optimize.differential_evolution(
        misfits,
        ranges,
        popsize=POPULATION,
        maxiter=generations,
        updating="deferred",
        vectorized=True,
        polish=False,
        rng=np.random.default_rng(seed),
    )


def _lines(model: LineModel, numbers: FloatArray) -> torch.Tensor:
    """Lines, shape [K, 6] [m], of places of ends [m] and logarithms of width and height, shape [K, 6]."""
    return model.clamped(torch.from_numpy(np.hstack([numbers[:, :4], np.exp(numbers[:, 4:])])))


def _misfits(fit: ImageFit, kept: torch.Tensor, numbers: FloatArray) -> FloatArray:
    """Of lines with numbers of shape [6, K], each alone beside those that are kept, shape [K]."""
    found = fit.losses_with_each(kept, _lines(fit.model, np.atleast_2d(numbers.T)))
    if fit.report is not None:
        fit.report(min(found))
    return np.asarray(found)


def _distinct(lines: torch.Tensor) -> torch.Tensor:
    """The first lines that end apart from all before, shape [K, 6] [m]."""
    found: list[torch.Tensor] = []
    for line in lines:
        turned = line[[2, 3, 0, 1]]
        if all(min((line[:4] - o[:4]).abs().max(), (turned - o[:4]).abs().max()) > APART_M for o in found):
            found.append(line)
        if len(found) == FOUND:
            break
    return torch.stack(found)
