"""Lines more and lines less, as the image has it.

A network blurs what is thinner than a sample, and errs where many lines lie on
top of each other; lines that explain its relief are then one too few, or one of
two. What of its relief no line explains says where to look; whether there is a
line, the image says.
"""

from collections.abc import Callable
from functools import partial

import torch

from nets.reconstruct.fibres.image.descent import Fitted
from nets.reconstruct.fibres.image.image_fit import ImageFit
from warp_caustics.prints.fit_each import fit_each
from warp_caustics.prints.model import HEIGHT, WIDTH, LineModel
from warp_caustics.prints.vectorise.proposals import proposed_lines

GROWTH_ROUNDS = 4
"""In which lines are proposed anew, at most."""
PROPOSED_RIDGES = 8
"""Highest points of what is unexplained through which lines are proposed, in two directions each."""
TRIED_PROPOSALS = 6
"""Proposals that are fitted to the image."""
RELIEF_FIT_ITERATIONS = 10
"""Steps of the fit to what is unexplained of the relief."""
IMAGE_FIT_ITERATIONS = 6
"""Of L-BFGS, in which a proposal must prove itself."""
GIVEN_UP_FACTOR = 1.02
"""A proposal that raises the misfit by this factor before anything has moved is not followed."""
FAILURES_IN_A_ROW = 2
"""Proposals that fail in a row before the others, less promising, are left alone."""
ADDED_LINE_FACTOR = 0.98
"""A new line must lower the misfit by this factor."""
REMOVED_LINE_FACTOR = 1.005
"""A line whose absence raises the misfit by less than this factor is removed."""
SUPERSAMPLING = 2
"""Of the relief of proposals: a quarter of the time, and exact enough for a start."""
LOWEST_LINE_M = 1e-5
"""What is unexplained and lower is no line [m]: a network leaves so much everywhere."""
UNSURE_M = 5e-5
"""Spread of the network's answers at which half of what is unexplained counts [m]."""
STARTING_WIDTHS = (1.0, 0.35)
"""Widths that a proposal starts with, relative to its ridge: a network widens thin lines, and keeps what is in them."""


def grown(fit: ImageFit, lines: torch.Tensor, relief_m: torch.Tensor, spread_m: torch.Tensor, most: int) -> Fitted:
    """Lines with those added that the image asks for, one at a time.

    Args:
        fit: judges.
        lines: shape [L, 6] [m].
        relief_m: of the network, shape [n, n] [m].
        spread_m: of its answers, shape [n, n] [m].
        most: lines, at most.
    """
    return grown_by(fit, lines, partial(_promising, fit, relief_m, spread_m), most)


def grown_by(
    fit: ImageFit, lines: torch.Tensor, promising: Callable[[Fitted], list[torch.Tensor]], most: int
) -> Fitted:
    """Lines with those added that the image asks for of some that may be missing.

    Args:
        fit: judges.
        lines: shape [L, 6] [m].
        promising: lines, shape [6] [m], that may be missing beside those so far, the most promising first.
        most: lines, at most.
    """
    best = Fitted(lines, fit.loss(fit.model.heights(lines)))
    for _ in range(GROWTH_ROUNDS):
        before, failed = best.loss, 0
        for line in promising(best):
            if len(best.lines) >= most:
                return best
            if failed == FAILURES_IN_A_ROW:
                break
            both = torch.cat([best.lines, line[None]])
            if fit.loss(fit.model.heights(both)) > GIVEN_UP_FACTOR * best.loss:
                continue  # another one has taken its place
            found = fit.descend(both, IMAGE_FIT_ITERATIONS)
            # The others have moved too: would they do without it?
            without = fit.loss(fit.model.heights(found.lines[:-1]))
            if found.loss < ADDED_LINE_FACTOR * min(best.loss, without):
                best, failed = found, 0
            else:
                failed += 1
        if best.loss == before:
            break
    return best


def _promising(fit: ImageFit, relief_m: torch.Tensor, spread_m: torch.Tensor, best: Fitted) -> list[torch.Tensor]:
    """Lines that may be missing of a relief, those first that explain the image best as they are."""
    total = fit.model.heights(best.lines)
    lines = proposals(fit.model, relief_m - total, spread_m)
    if not len(lines):
        return []
    if fit.report is not None:
        fit.report(best.loss)
    losses = fit.losses_with_each(best.lines, lines)
    return [lines[k] for _, k in sorted((loss, k) for k, loss in enumerate(losses))[:TRIED_PROPOSALS]]


def proposals(
    model: LineModel, rest_m: torch.Tensor, spread_m: torch.Tensor, ridges: int = PROPOSED_RIDGES
) -> torch.Tensor:
    """Lines along what is unexplained, fitted to it, shape [K, 6] [m]; of several starts the best.

    Args:
        model: renders lines.
        rest_m: what is unexplained, shape [n, n] [m].
        spread_m: how unsure it is, shape [n, n] [m].
        ridges: highest points through which lines are proposed, in two directions each.
    """
    sketch = model.sketched(SUPERSAMPLING)
    view = rest_m / (1 + (spread_m / UNSURE_M).square()).sqrt()
    view = torch.where(view > LOWEST_LINE_M, view, 0.0)
    sigma = (spread_m.square() + UNSURE_M**2).sqrt()
    size = model.scene.plate_size_m
    along = torch.from_numpy(proposed_lines(view.double().cpu().numpy(), size, ridges, model.shape))
    starts = along.repeat(len(STARTING_WIDTHS), 1)
    factors = torch.tensor(STARTING_WIDTHS, dtype=torch.float64).repeat_interleave(len(along))
    starts[:, WIDTH] *= factors
    starts[:, HEIGHT] /= factors
    lines, losses = fit_each(sketch, model.clamped(starts), rest_m, sigma, iterations=RELIEF_FIT_ITERATIONS)
    best = losses.reshape(len(STARTING_WIDTHS), -1).argmin(dim=0) if len(along) else torch.zeros(0, dtype=torch.long)
    return lines[best * len(along) + torch.arange(len(along))]


def pruned(fit: ImageFit, lines: torch.Tensor) -> Fitted:
    """Lines without those that the image does not miss, the least first."""
    current, kept = fit.loss(fit.model.heights(lines)), list(range(len(lines)))
    asked = fit.model.each(lines).flatten(1).sum(dim=1).argsort().tolist()
    while asked:
        without = fit.model.heights_without_each(lines[kept])
        losses = fit.losses(without[[kept.index(k) for k in asked]], fit.model.heights(lines[kept]))
        spare = next((i for i, loss in enumerate(losses) if loss < REMOVED_LINE_FACTOR * current), None)
        if spare is None:
            break
        kept.remove(asked[spare])
        current = losses[spare]
        asked = asked[spare + 1 :]
    return Fitted(lines[kept], current)
