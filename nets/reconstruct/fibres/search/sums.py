"""Lines that lie on each other in part, found as their sum there and as what is left of each.

Two lines that cross at a few degrees are nearly one for a third of their way. A search finds one line there that is as
high as both, ends each of them where it begins, and fills what is wrong of that with short ones: no end can go on
through the sum without making the image worse, and the sum cannot go. So lines that end at a higher one, and point into
it, go on through it, which is lower by as much or gone, and all lines descend. Of two own plates of caps 13.1 and 11.8
um off lines were 2.2 and 5.2 um off then.
"""

import itertools
import math
from collections.abc import Iterator

import torch

from nets.reconstruct.fibres.image.descent import Fitted
from nets.reconstruct.fibres.image.image_fit import ImageFit
from nets.reconstruct.fibres.search.moves import stretched
from nets.reconstruct.fibres.search.rounds import while_better
from warp_caustics.prints.model import HEIGHT

MEETING_M = 4e-3
"""How far from the end of a sum those end that go on in it [m]."""
DIRECTION_DEG = 20.0
"""Of those against the sum, at most."""
BESIDE_M = 3e-3
"""Lines of which both ends are as near as this to a sum fill what is wrong of it [m]."""
REST = 0.3
"""Of a sum's height that stays after those that go on are taken off, below which it goes."""
TOO_HIGH, LOW = 0.5, 0.25
"""Of a sum's height by which those that go on may be higher together, and below which each is none of its parts."""
ROUNDS = 3
"""In which sums are taken apart, one each, at most."""
TRIED = {"cpu": 4, "cuda": 24}
"""Ways in a round that are given a descent, those first that explain the image best as they are."""
TRIAL_ITERATIONS = 25
"""Of L-BFGS of all lines: what goes on is found where it was not by as much as it was bent."""
GIVEN_UP_FACTOR = 4.0
"""What raises the misfit by this factor before anything has moved is not followed."""
APART_FACTOR = 0.97
"""A way must lower the misfit by this factor, against the same descent of lines as they are."""
CLEARLY_BETTER = 0.8
"""By this factor, and no other way is tried."""


def taken_apart(fit: ImageFit, lines: torch.Tensor, quick: ImageFit | None = None) -> Fitted | None:
    """Lines of which some go on through what was their sum, where the image likes it better; None where it does not.

    Args:
        fit: judges.
        lines: shape [L, 6] [m].
        quick: says which of all ways are tried; ``fit`` if None.
    """
    return while_better(lambda each: _once(fit, each, quick or fit), lines, ROUNDS)


def _once(fit: ImageFit, lines: torch.Tensor, quick: ImageFit) -> Fitted | None:
    """The way that the image likes best."""
    ways = list(ways_through(lines))
    if not ways:
        return None
    heights = [fit.model.heights(each) for each in (lines, *ways)]
    now, *losses = quick.losses(torch.stack(heights), heights[0])
    order = sorted(zip(losses, range(len(ways)), strict=True))[: TRIED[fit.model.device.type]]
    if order[0][0] > GIVEN_UP_FACTOR * now:
        return None
    as_they_are = fit.descend(lines, TRIAL_ITERATIONS).loss
    best, least = None, APART_FACTOR * as_they_are
    for loss, number in order:
        if loss > GIVEN_UP_FACTOR * now:
            break
        found = fit.descend(ways[number], TRIAL_ITERATIONS)
        if found.loss < least:
            best, least = found, found.loss
            if least < CLEARLY_BETTER * as_they_are:
                break
    return best


def ways_through(lines: torch.Tensor) -> Iterator[torch.Tensor]:
    """Lines [M, 6] [m] of which some go on through what may be their sum, what changed last.

    The sum is lower by what goes on, or gone; with what lies beside it, and without.

    Args:
        lines: shape [L, 6] [m].
    """
    for k, line in enumerate(lines):
        for column in (0, 2):
            meeting = _going_on(lines, k, column)
            some = [[each] for each in meeting] + [list(pair) for pair in itertools.combinations(meeting, 2)]
            beside = _beside(lines, k) - {j for j, _ in meeting}
            for going in some:
                high = float(line[HEIGHT]) - sum(float(lines[j, HEIGHT]) for j, _ in going)
                if high < -TOO_HIGH * float(line[HEIGHT]):
                    continue
                changed = [_to(lines[j], end, line[2 - column : 4 - column]) for j, end in going]
                if high > REST * float(line[HEIGHT]):
                    rest = line.clone()
                    rest[HEIGHT] = high
                    changed.append(rest)
                for gone in [set[int](), beside] if beside else [set[int]()]:
                    left = {k, *gone, *(j for j, _ in going)}
                    kept = [lines[j] for j in range(len(lines)) if j not in left]
                    yield torch.stack(kept + changed)


def _going_on(lines: torch.Tensor, k: int, column: int) -> list[tuple[int, int]]:
    """Lines that end where line k ends in a column and point into it, with the columns of their ends; lower ones."""
    here, far = lines[k, column : column + 2], lines[k, 2 - column : 4 - column]
    way = (far - here) / (far - here).norm().clamp_min(1e-12)
    found = []
    for j, other in enumerate(lines):
        if j == k or not LOW * float(lines[k, HEIGHT]) <= float(other[HEIGHT]) < float(lines[k, HEIGHT]):
            continue
        for end in (0, 2):
            outward = other[end : end + 2] - other[2 - end : 4 - end]
            length, away = float(outward.norm()), float((other[end : end + 2] - here).norm())
            is_along = float(outward @ way) > math.cos(math.radians(DIRECTION_DEG)) * length
            if is_along and away <= MEETING_M < length:
                found.append((j, end))
    return found


def _to(line: torch.Tensor, end: int, far: torch.Tensor) -> torch.Tensor:
    """A line [6] that goes on at an end as far as a point, shape [2]."""
    outward = line[end : end + 2] - line[2 - end : 4 - end]
    return stretched(line, end, float((far - line[end : end + 2]) @ outward / outward.norm().clamp_min(1e-12)))


def _beside(lines: torch.Tensor, k: int) -> set[int]:
    """Other lines of which both ends lie beside line k."""
    start, way = lines[k, :2], lines[k, 2:4] - lines[k, :2]
    ends = lines[:, :4].reshape(-1, 2, 2)
    share = (((ends - start) @ way) / (way @ way).clamp_min(1e-18)).clamp(0.0, 1.0)
    away = (ends - start - share[..., None] * way).norm(dim=2).amax(dim=1)
    return {j for j in range(len(lines)) if j != k and float(away[j]) <= BESIDE_M}
