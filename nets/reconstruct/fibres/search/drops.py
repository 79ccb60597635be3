"""Two round drops that are told by a line between them.

Drops that lie on each other for a half of their width are nearly a short line from the middle of one to that of the
other, and what of one is higher is told by another drop at its end. Each number of those is right as it stands, so that
no descent leads from there: an own plate was 3.2 um off.
"""

from collections.abc import Iterator

import torch

from nets.reconstruct.fibres.image.descent import Fitted
from nets.reconstruct.fibres.image.image_fit import ImageFit
from nets.reconstruct.fibres.search.moves import drops as round_drops
from nets.reconstruct.fibres.search.moves import is_short
from nets.reconstruct.fibres.search.rounds import while_better
from warp_caustics.prints.model import HEIGHT

APART_M = 5e-4
"""Shorter lines are one drop."""
SAME_M = 6e-4
"""A drop as near as this to an end is the one there."""
TRIAL_ITERATIONS = 20
"""Of L-BFGS of all lines."""
APART_FACTOR = 0.97
"""By which two drops must lower the misfit, against the same descent of lines as they are."""
ROUNDS = 3


def with_drops_apart(fit: ImageFit, lines: torch.Tensor, *, with_section: bool = False) -> Fitted | None:
    """Lines of which some have become two drops each, where the image likes it better; None where it does not.

    Args:
        fit: judges.
        lines: shape [L, 6] [m].
        with_section: descents move the model's section, too.
    """
    return while_better(lambda each: _once(fit, each, with_section), lines, ROUNDS)


def _once(fit: ImageFit, lines: torch.Tensor, with_section: bool) -> Fitted | None:
    """The best way that is better than lines as they are."""
    ways = list(drops_apart(lines))
    if not ways:
        return None
    given, best = fit.model.shape, None
    least = APART_FACTOR * fit.descend(lines, TRIAL_ITERATIONS, with_section=with_section).loss
    as_found = given
    for way in ways:
        fit.model.shape = given
        found = fit.descend(way, TRIAL_ITERATIONS, with_section=with_section)
        if found.loss < least:
            best, least, as_found = found, found.loss, fit.model.shape
    fit.model.shape = as_found
    if best is None:
        return None
    rounded = fit.descend(_rounded(fit, best.lines), TRIAL_ITERATIONS, with_section=with_section)
    if rounded.loss < best.loss:
        return rounded
    fit.model.shape = as_found
    return best


def _rounded(fit: ImageFit, lines: torch.Tensor) -> torch.Tensor:
    """Lines of which the last two are those round drops, each by itself, that the image likes best.

    Light of a drop is told by one that is a tenth off, and by none farther away.
    """
    model, lines = fit.model, lines.clone()
    for k in (len(lines) - 2, len(lines) - 1):
        versions = [lines[k], *round_drops(lines[k])]
        tried = torch.stack([torch.cat([lines[:k], lines[k + 1 :], each[None]]) for each in versions])
        reliefs = torch.stack([model.heights(each) for each in model.clamped(tried)])
        losses = fit.losses(reliefs, reliefs[0])
        lines[k] = model.clamped(tried[min(range(len(losses)), key=losses.__getitem__)])[-1]
    return lines


def drops_apart(lines: torch.Tensor) -> Iterator[torch.Tensor]:
    """Lines [M, 6] [m] of which one has become a drop at each end, which are as high as all that is there together.

    Args:
        lines: shape [L, 6] [m].
    """
    lengths = (lines[:, 2:4] - lines[:, :2]).norm(dim=1)
    middles = (lines[:, :2] + lines[:, 2:4]) / 2
    for k, line in enumerate(lines):
        if not (is_short(line) and float(lengths[k]) > APART_M):
            continue
        gone, drops = {k}, []
        for end in (0, 2):
            at = line[end : end + 2]
            here = (lengths <= APART_M) & ((middles - at).norm(dim=1) <= SAME_M)
            drop = torch.cat([at, at, line[4:]])
            drop[HEIGHT] += lines[here, HEIGHT].sum()
            drops.append(drop)
            gone |= set(here.nonzero()[:, 0].tolist())
        yield torch.stack([*(lines[j] for j in range(len(lines)) if j not in gone), *drops])
