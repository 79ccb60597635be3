"""Pieces of one line joined.

Where lines cross in a crowd a search often finds one in two pieces, equally wide and high to three digits, and fills
the gap between them with something else that explains its light nearly as well. No small step leads from there to the
whole line; that pieces lie along one line tells that there is one.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import torch

from nets.reconstruct.fibres.image.descent import Fitted
from nets.reconstruct.fibres.image.image_fit import ImageFit
from nets.reconstruct.fibres.search.ends import SHORT_M, ends_moved
from nets.reconstruct.fibres.search.growth import REMOVED_LINE_FACTOR
from warp_caustics.prints.model import HEIGHT, WIDTH

OFF_LINE = 0.15
"""How far ends of pieces may lie off their common line, relative to the smaller width."""
ALIKE_FACTOR = 1.2
"""By which widths and heights of pieces may differ."""
OVERLAP_M = 2e-3
"""How far pieces may lie on top of each other [m]."""
NEAR_M = 4e-3
"""Gaps whose middles are as near as this may be filled together [m]: what is wrong at one is wrong at the others."""
BESIDE_M = 1.5e-3
"""How far from a gap middles of short lines may lie that filled it [m]."""
ROUNDS = 4
"""In which pieces are looked for anew, at most."""
TRIED = 5
"""Of the ways to join pieces in a round, those that explain the image best as they are."""
TRIAL_ITERATIONS = 8
"""Of L-BFGS after pieces were joined."""
GIVEN_UP_FACTOR = 2.0
"""What raises the misfit by this factor before anything has moved is not followed."""


STACKED_OFF_M = 3e-4
"""How far ends of lines on top of each other may lie off their common line [m], however wide they are."""
STACKED_M = 2e-3
"""How far apart ends of lines that lie on top of each other along one line may be [m]."""


class Gap(NamedTuple):
    """Between two pieces that may be one line: their indices, its middle [m], shape [2], and half its length [m]."""

    pair: tuple[int, int]
    middle: torch.Tensor
    half_m: float


def with_joins(fit: ImageFit, lines: torch.Tensor, quick: ImageFit | None = None) -> Fitted:
    """Lines with pieces joined where the image allows it: each line less may raise the misfit as if it were removed.

    Args:
        fit: judges.
        lines: shape [L, 6] [m].
        quick: says which of all ways are tried; ``fit`` if None.
    """
    best = Fitted(lines, fit.loss(fit.model.heights(lines)))
    for _ in range(ROUNDS):
        found = _joined_once(fit, best, quick or fit)
        if found is None:
            break
        best = found
    return best


def _joined_once(fit: ImageFit, before: Fitted, quick: ImageFit) -> Fitted | None:
    """After the first of the ways to join pieces that the image allows; None where it allows none."""
    ways = list(ways_to_join(before.lines))
    if not ways:
        return None
    heights = [fit.model.heights(lines) for lines in (before.lines, *(way for way, _ in ways))]
    now, *losses = quick.losses(torch.stack(heights), heights[0])
    tried = sorted((loss, number) for number, loss in enumerate(losses))[:TRIED]
    found = [(loss, ways[number][0]) for loss, number in tried]
    for _, number in tried:
        # Where lines meet, those that end there have given way to the pieces.
        found += ends_moved(quick, *ways[number])
    for loss, lines in sorted(found, key=lambda each: each[0])[:TRIED]:
        if loss > GIVEN_UP_FACTOR * now:
            break
        joined = fit.descend(lines, TRIAL_ITERATIONS)
        if joined.loss < before.loss * REMOVED_LINE_FACTOR ** (len(before.lines) - len(lines)):
            return joined
    return None


def gaps_between(lines: torch.Tensor) -> list[Gap]:
    """Gaps between lines [L, 6] [m] that may be pieces of one."""
    found = []
    ratios = lines[:, None, WIDTH:] / lines[None, :, WIDTH:]
    alike = torch.maximum(ratios, 1 / ratios).amax(-1) <= ALIKE_FACTOR
    pairs = alike.triu(1).nonzero()
    ends, along, off = _of_pairs(lines, pairs)
    gaps = _gaps(along)
    thinner = lines[pairs, WIDTH].amin(1)
    for k in ((off <= OFF_LINE * thinner) & (gaps >= -OVERLAP_M)).nonzero()[:, 0].tolist():
        low, high = along[k].reshape(2, 2).amin(1), along[k].reshape(2, 2).amax(1)
        inner = ends[k][[int((along[k] - at).abs().argmin()) for at in (low.max(), high.min())]]
        i, j = pairs[k].tolist()
        found.append(Gap((i, j), inner.mean(0), max(float(gaps[k]), 0.0) / 2))
    return found


def _of_pairs(lines: torch.Tensor, pairs: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Of pairs [K, 2] of lines their ends, shape [K, 4, 2], places of these and the most that one lies off [m], [K]."""
    ends = lines[pairs, :4].reshape(-1, 4, 2)
    along, off = _along(ends)
    return ends, along, off.amax(1)


def _gaps(along: torch.Tensor) -> torch.Tensor:
    """How far apart lines are of which two ends each lie at such places, shape [K, 4] [m]; below 0 they overlap."""
    of_lines = along.reshape(-1, 2, 2)
    return of_lines.amin(2).amax(1) - of_lines.amax(2).amin(1)


def _along(ends: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Of points [..., P, 2] the places along the line through the two farthest, and distances from it [m], [..., P]."""
    apart = (ends[..., :, None, :] - ends[..., None, :, :]).square().sum(-1)
    farthest = apart.flatten(-2).argmax(-1)
    first, last = (
        torch.take_along_dim(ends, at[..., None, None], -2)
        for at in (farthest // ends.shape[-2], farthest % ends.shape[-2])
    )
    direction = (last - first) / (last - first).norm(dim=-1, keepdim=True).clamp_min(1e-12)
    from_first = ends - first
    beside = from_first[..., 1] * direction[..., 0] - from_first[..., 0] * direction[..., 1]
    return (from_first * direction).sum(-1), beside.abs()


def stacks(lines: torch.Tensor) -> list[list[int]]:
    """Groups of lines [L, 6] [m] that lie on top of each other along one line, of whatever width and height.

    A line that is told too low all along has others on top of it, end to end, that make up for the rest: none of them
    is like it, and the image misses each.
    """
    groups: list[set[int]] = []
    pairs = torch.tril_indices(len(lines), len(lines), -1).T
    _, along, off = _of_pairs(lines, pairs)
    most_off = (OFF_LINE * lines[pairs, WIDTH].amin(1)).clamp_max(STACKED_OFF_M)
    for i, j in pairs[(off <= most_off) & (_gaps(along) <= STACKED_M)].tolist():
        touched = [group for group in groups if group & {i, j}]
        groups = [group for group in groups if group not in touched] + [{i, j}.union(*touched)]
    return [sorted(group) for group in groups]


def unstacked(pieces: torch.Tensor) -> torch.Tensor:
    """The line [6] [m] that lines on top of each other [K, 6] [m] stand for: as long as all, with as much in it."""
    line = whole(pieces)
    lengths = (pieces[:, 2:4] - pieces[:, :2]).norm(dim=1).clamp_min(1e-9)
    volumes = lengths * pieces[:, WIDTH] * pieces[:, HEIGHT]
    line[WIDTH] = (pieces[:, WIDTH] * volumes).sum() / volumes.sum()
    line[HEIGHT] = volumes.sum() / (line[WIDTH] * (line[2:4] - line[:2]).norm().clamp_min(1e-9))
    return line


def whole(pieces: torch.Tensor) -> torch.Tensor:
    """The line [6] [m] that pieces [K, 6] [m] belong to: as long as all, as wide and high as most of it."""
    ends = pieces[:, :4].reshape(-1, 2)
    along, _ = _along(ends)
    lengths = (pieces[:, 2:4] - pieces[:, :2]).norm(dim=1).clamp_min(1e-9)
    size = (pieces[:, [WIDTH, HEIGHT]] * lengths[:, None]).sum(0) / lengths.sum()
    return torch.cat([ends[int(along.argmin())], ends[int(along.argmax())], size])


def ways_to_join(lines: torch.Tensor) -> Iterator[tuple[torch.Tensor, tuple[float, float]]]:
    """Ways to join pieces: lines [M, 6] [m], and where a gap was [m].

    Gap by gap, those near each other together, and all of them; each with short lines at the gaps, and without. And
    lines on top of each other as one.
    """
    gaps = gaps_between(lines)
    together = [_near(gaps, gap) for gap in gaps]
    seen = set()
    for some in [[gap] for gap in gaps] + together + [gaps]:
        key = frozenset(gap.pair for gap in some)
        if not some or key in seen:
            continue
        seen.add(key)
        fillers = _fillers(lines, some)
        x, y = some[0].middle.tolist()
        yield _joined(lines, some, set()), (x, y)
        if fillers:
            yield _joined(lines, some, fillers), (x, y)
    for stack in stacks(lines):
        kept = [lines[k] for k in range(len(lines)) if k not in stack]
        line = unstacked(lines[stack])
        x, y = ((line[:2] + line[2:4]) / 2).tolist()
        yield torch.stack([*kept, line]), (x, y)


def _near(gaps: Sequence[Gap], to: Gap) -> list[Gap]:
    return [gap for gap in gaps if float((gap.middle - to.middle).norm()) <= NEAR_M]


def _fillers(lines: torch.Tensor, gaps: Sequence[Gap]) -> set[int]:
    """Indices of short lines at gaps, beside the pieces themselves."""
    pieces = {k for gap in gaps for k in gap.pair}
    short = (lines[:, 2:4] - lines[:, :2]).norm(dim=1) < SHORT_M
    middles = (lines[:, :2] + lines[:, 2:4]) / 2
    return {
        k
        for gap in gaps
        for k in range(len(lines))
        if short[k] and k not in pieces and float((middles[k] - gap.middle).norm()) <= gap.half_m + BESIDE_M
    }


def _joined(lines: torch.Tensor, gaps: Sequence[Gap], left_out: set[int]) -> torch.Tensor:
    groups: list[set[int]] = []
    for gap in gaps:
        touched = [group for group in groups if group & set(gap.pair)]
        groups = [group for group in groups if group not in touched] + [set(gap.pair).union(*touched)]
    gone = left_out.union(*groups)
    kept = [lines[k] for k in range(len(lines)) if k not in gone]
    return torch.stack(kept + [whole(lines[sorted(group)]) for group in groups])
