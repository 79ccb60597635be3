"""Lines of one search and of another of the same image, the better of both in each place.

Each is right in most places and stuck in others. Where they differ, the lines of one take the places of the other's,
a group that lies on top of each other at a time, and the image says which are better.
"""

from typing import NamedTuple

import torch

from nets.reconstruct.fibres.image.descent import Fitted
from nets.reconstruct.fibres.image.image_fit import ImageFit

SAME_SHARE = 0.7
"""Volume that two lines have in common, of what both take, above which they are the same."""
RIVAL_SHARE = 0.12
"""Above which one stands for the other: lines that cross have less in common."""
TRIED = 12
"""Groups that are given a descent, those first that explain the image best as they are."""
TRIAL_ITERATIONS = 6
"""Of L-BFGS after an exchange."""
GIVEN_UP_FACTOR = 1.5
"""What raises the misfit by this factor before anything has moved is not followed."""
EXCHANGED_FACTOR = 0.99
"""An exchange must lower the misfit by this factor."""


class Rivals(NamedTuple):
    """Indices of lines of one search, and of those of the other that stand in their place; either may be none."""

    mine: list[int]
    theirs: list[int]


def exchanged(fit: ImageFit, mine: torch.Tensor, theirs: torch.Tensor) -> Fitted:
    """Lines with those of another search where these explain the image better.

    Args:
        fit: judges.
        mine: shape [L, 6] [m].
        theirs: shape [M, 6] [m], of the same section.
    """
    model, best = fit.model, Fitted(mine, fit.loss(fit.model.heights(mine)))
    groups = rivals(model.each(mine), model.each(theirs))
    origin = list(range(len(mine)))  # of the lines so far; what came from the other has none

    def without(group: Rivals) -> list[int]:
        return [place for place, number in enumerate(origin) if number not in group.mine]

    def swapped(group: Rivals) -> torch.Tensor:
        return torch.cat([best.lines[without(group)], theirs[group.theirs]])

    first = [fit.loss(model.heights(swapped(group))) for group in groups]
    for _, number in sorted(zip(first, range(len(groups)), strict=True))[:TRIED]:
        group = groups[number]
        lines = swapped(group)
        if not len(lines) or fit.loss(model.heights(lines)) > GIVEN_UP_FACTOR * best.loss:
            continue
        found = fit.descend(lines, TRIAL_ITERATIONS)
        if found.loss < EXCHANGED_FACTOR * best.loss:
            origin = [origin[place] for place in without(group)] + [-1] * len(group.theirs)
            best = found
    return best


def rivals(mine: torch.Tensor, theirs: torch.Tensor) -> list[Rivals]:
    """Groups of lines in which two searches differ.

    Args:
        mine: relief of each line of one [m], shape [L, n, n].
        theirs: of the other, shape [M, n, n].
    """
    share = torch.zeros(len(mine), len(theirs))
    flat = theirs.flatten(1)
    for k, one in enumerate(mine.flatten(1)):
        both = torch.minimum(one, flat).sum(1) / torch.maximum(one, flat).sum(1).clamp_min(1e-30)
        share[k] = both.cpu()
    same, near = share > SAME_SHARE, share > RIVAL_SHARE
    left = {k for k in range(len(mine)) if not same[k].any()}
    others = {k for k in range(len(theirs)) if not same[:, k].any()}
    groups = []
    while left or others:
        group, todo = Rivals([], []), [(0, left.pop()) if left else (1, others.pop())]
        while todo:
            side, k = todo.pop()
            group[side].append(k)
            reached = [j for j in others if near[k, j]] if side == 0 else [j for j in left if near[j, k]]
            (others if side == 0 else left).difference_update(reached)
            todo += [(1 - side, j) for j in reached]
        groups.append(group)
    return groups
