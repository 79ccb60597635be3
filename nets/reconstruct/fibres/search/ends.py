"""Ends of lines that meet, moved together.

Where ends of several lines lie on top of each other one is found too long and another too short: neither can move alone
without making the image worse, and something short is taken for what is missing.
"""

import itertools

import torch

from nets.reconstruct.fibres.image.descent import Fitted
from nets.reconstruct.fibres.image.image_fit import ImageFit
from nets.reconstruct.fibres.search.moves import stretched
from nets.reconstruct.fibres.search.places import worst_places

PLACES = 2
"""Those with the worst misfit, at which ends are moved."""
REACH_M = 4e-3
"""Ends as near as this to a place are moved [m]."""
ENDS = 3
"""The nearest, at a place."""
SHORT_M = 3e-3
"""Lines shorter than this may be what was taken for the end of another [m]."""
STRETCHES_M = (0.0, -4e-3, -2e-3, -1e-3, 1e-3, 2e-3, 4e-3)
TRIED = 4
"""Of all that were simulated, those that are given a descent."""
TRIAL_ITERATIONS = 8
"""Of L-BFGS after ends were moved."""
GIVEN_UP_FACTOR = 1.3
"""What raises the misfit by this factor before anything else has moved is not followed."""
MOVED_FACTOR = 0.98
"""What is moved must lower the misfit by this factor."""


def with_moved_ends(fit: ImageFit, lines: torch.Tensor, quick: ImageFit | None = None) -> Fitted:
    """Lines with ends moved together, and short lines left out, where the image is explained worst and likes it better.

    Args:
        fit: judges.
        lines: shape [L, 6] [m].
        quick: says which of all ways are tried; ``fit`` if None.
    """
    quick = quick or fit
    best = Fitted(lines, fit.loss(fit.model.heights(lines)))
    for place in worst_places(fit, fit.model.heights(lines), PLACES):
        ways = [
            (loss, moved)
            for left_out in left_out_at(best.lines, place)
            for loss, moved in ends_moved(quick, without(best.lines, left_out), place)
        ]
        before, now = best, quick.loss(fit.model.heights(best.lines))
        for loss, moved in sorted(ways, key=lambda way: way[0])[:TRIED]:
            if loss > GIVEN_UP_FACTOR * now:
                break
            found = fit.descend(moved, TRIAL_ITERATIONS)
            if found.loss < MOVED_FACTOR * before.loss:
                best = found
                break
    return best


def left_out_at(lines: torch.Tensor, place: tuple[float, float]) -> list[list[int]]:
    """No line, and all short ones at a place, if there are any."""
    lengths = (lines[:, 2:4] - lines[:, :2]).norm(dim=1)
    away = ((lines[:, :2] + lines[:, 2:4]) / 2 - lines.new_tensor(place)).norm(dim=1)
    short: list[int] = ((lengths < SHORT_M) & (away < REACH_M)).nonzero()[:, 0].tolist()
    return [[], short] if short else [[]]


def without(lines: torch.Tensor, left_out: list[int]) -> torch.Tensor:
    """Lines [L, 6] but some, by their numbers."""
    return lines[[k for k in range(len(lines)) if k not in left_out]]


def ends_moved(fit: ImageFit, lines: torch.Tensor, place: tuple[float, float]) -> list[tuple[float, torch.Tensor]]:
    """Misfits of lines with ends at a place moved in all ways, the least :data:`TRIED`, and those lines, [L, 6] [m].

    Args:
        fit: judges.
        lines: shape [L, 6] [m].
        place: x and y on the plate [m].
    """
    model, ends = fit.model, ends_near(lines, place)
    if not ends:
        return []
    versions = [stretched(lines[k], column, lines.new_tensor(STRETCHES_M)[:, None]) for k, column in ends]
    rest = without(lines, [k for k, _ in ends])
    ways = list(itertools.product(range(len(STRETCHES_M)), repeat=len(ends)))
    if model.shape.overlap == 1:
        total = model.heights(rest)[None]
        for version in versions:
            total = (total[:, None] + model.each(model.clamped(version))).flatten(0, 1)
    else:
        moved_ends = [torch.stack([version[k] for version, k in zip(versions, way, strict=True)]) for way in ways]
        total = model.with_each(rest, model.clamped(torch.stack(moved_ends)))
    losses = fit.losses(total, model.heights(lines))
    found = []
    for loss, number in sorted(zip(losses, range(len(ways)), strict=True))[:TRIED]:
        moved = lines.clone()
        for (k, _), version, way in zip(ends, versions, ways[number], strict=True):
            moved[k] = version[way]
        found.append((loss, model.clamped(moved)))
    return found


def ends_near(lines: torch.Tensor, place: tuple[float, float], most: int = ENDS) -> list[tuple[int, int]]:
    """Lines and columns of the ends nearest to a place, of a line no more than one."""
    away = torch.stack([(lines[:, c : c + 2] - lines.new_tensor(place)).norm(dim=1) for c in (0, 2)], dim=1)
    nearest, column = away.min(dim=1)
    order = nearest.argsort()[:most].tolist()
    return [(k, 2 * int(column[k])) for k in order if float(nearest[k]) <= REACH_M]
