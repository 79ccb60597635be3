"""Jumps that descent cannot make: a line that ends elsewhere, or is thinner and higher.

A line that is a few millimetres short leaves its fold dark over all of the
missing part, and no small step shows that a long one would help.
"""

import math
from collections.abc import Iterator

import numpy as np
import scipy  # loads its parts when they are first used
import torch

from nets.reconstruct.fibres.image.image_fit import ImageFit
from nets.reconstruct.fibres.search.places import cell_misfits
from warp_caustics.prints.model import HEIGHT, WIDTH, LineModel

SHORTER_M = (-1.6e-2, -8e-3, -4e-3, -2e-3, -1e-3, -5e-4, -2.5e-4)
LONGER_M = (2.5e-4, 5e-4, 1e-3, 2e-3, 4e-3, 8e-3, 1.2e-2, 1.8e-2, 2.7e-2)
STRETCHES_M = (*SHORTER_M, *LONGER_M)
"""The least is less than a sample: of lines on top of each other, 3 mm high, one ended 0.3 mm too soon, which took half
a millimetre from six samples, 5 um from the plate. Descent stayed there, and half a millimetre more was no better. The
most is half a plate: where higher lines lie on top of one, or the highest is printed, it may end where it disappears
under them and go on behind them, and the image hardly likes the first 8 mm: 0.98 of the misfit, and 0.88 at 20."""
RESHAPING_FACTORS = (0.6, 1.5)
ROUND_WIDTHS, ROUND_HEIGHTS = np.geomspace(0.7, 1.4, 9), np.geomspace(0.5, 2.4, 17)
"""Of drops that stand for a short line, relative to it: light of one is told by a drop that is a tenth off, and by none
farther away. One of 2.4 mm was told by a line 0.3 mm long, a third of it lower, and all but exactly by the drop after
that."""
ROUND_LINES = 2
"""Of short lines those that drops are tried for."""
JUMP_FACTOR = 0.995
"""A jump must lower the misfit by this factor."""
RESHAPED_LINES = 6
"""Lines whose width and height are tried too: those with the worst misfit under them."""
SHORTEST_M = 1e-4


def stretches(line: torch.Tensor) -> Iterator[tuple[torch.Tensor, int, float]]:
    """Lines with one end moved along, shape [6] [m]; the column of that end, and the length gained [m]."""
    length = float((line[2:4] - line[:2]).norm())
    changes = [change for change in STRETCHES_M if change > -length + SHORTEST_M]
    of_ends = [stretched(line, end, line.new_tensor(changes)[:, None]).unbind() for end in (0, 2)]
    for change, *both in zip(changes, *of_ends, strict=True):
        yield from ((moved, end, change) for moved, end in zip(both, (0, 2), strict=True))


def stretched(line: torch.Tensor, end: int, change_m: float | torch.Tensor) -> torch.Tensor:
    """A line [6] longer by so much at the end in column 0 or 2; lines, shape [K, 6], of changes of shape [K, 1]."""
    other = 2 - end
    outward = line[end : end + 2] - line[other : other + 2]
    by = change_m * outward / max(float(outward.norm()), 1e-12)
    moved = line.expand(*by.shape[:-1], 6).clone()
    moved[..., end : end + 2] += by
    return moved


def shapes(line: torch.Tensor) -> Iterator[torch.Tensor]:
    """Lines of another width, height, or both at the same cross section, each of shape [6] [m]."""
    for factor in RESHAPING_FACTORS:
        for width, height in ((1.0, factor), (factor, 1.0), (factor, 1 / factor)):
            reshaped = line.clone()
            reshaped[WIDTH], reshaped[HEIGHT] = width * line[WIDTH], height * line[HEIGHT]
            yield reshaped


def is_short(line: torch.Tensor) -> bool:
    """Whether a line, shape [6] [m], is shorter than wide."""
    return bool((line[2:4] - line[:2]).norm() < line[WIDTH])


def drops(line: torch.Tensor) -> Iterator[torch.Tensor]:
    """Round drops in the middle of a line, of many widths and heights, each of shape [6] [m]."""
    middle = (line[:2] + line[2:4]) / 2
    for width in ROUND_WIDTHS:
        for height in ROUND_HEIGHTS:
            drop = torch.cat([middle, middle, line[WIDTH:]])
            drop[WIDTH] *= float(width)
            drop[HEIGHT] *= float(height)
            yield drop


def jump(
    fit: ImageFit, lines: torch.Tensor, most: int | None = None, quick: ImageFit | None = None
) -> tuple[torch.Tensor, bool]:
    """Lines after the best jump of each, and whether any jumped.

    Args:
        fit: judges; a coarse image will do.
        lines: shape [L, 6] [m].
        most: lines that are tried, those with the worst misfit under them first; all if None.
        quick: says which jump of a line is its best; ``fit`` if None.
    """
    quick, judge = quick or fit, None if quick is None else fit
    model, lines = fit.model, lines.clone()
    heights, jumped = model.heights(lines), False
    current, judged = quick.loss(heights), math.inf if judge is None else judge.loss(heights)

    def best_of(k: int, tried: list[torch.Tensor]) -> tuple[float, int]:
        others = torch.cat([lines[:k], lines[k + 1 :]])
        losses = quick.losses_with_each(others, model.clamped(torch.stack(tried)))
        if fit.report is not None:
            fit.report(current)
        return min((loss, number) for number, loss in enumerate(losses))

    for rank, k in enumerate(suspects(fit, model, lines)[:most]):
        longer = list(stretches(lines[k]))
        tried = [line for line, _, _ in longer]
        if rank < RESHAPED_LINES:
            tried += shapes(lines[k])
        if rank < ROUND_LINES and is_short(lines[k]):
            tried += drops(lines[k])
        least, number = best_of(k, tried)
        if least >= current * JUMP_FACTOR:
            continue
        best = tried[number]
        if number < len(longer):
            # Between the steps that were tried.
            _, end, change = longer[number]
            between = [stretched(lines[k], end, part * change) for part in (0.7, 1.4)]
            found, number = best_of(k, between)
            if found < least:
                best, least = between[number], found
        best = model.clamped(best[None])
        if judge is not None:
            least_judged = judge.loss(model.heights(torch.cat([lines[:k], best, lines[k + 1 :]])))
            if least_judged >= judged * JUMP_FACTOR:
                continue
            judged = least_judged
        jumped, current, lines[k] = True, least, best[0]
    return lines, jumped


def suspects(fit: ImageFit, model: LineModel, lines: torch.Tensor) -> list[int]:
    """Indices of all lines, that with the worst misfit under and around it first.

    Args:
        fit: gives the measured image.
        model: gives the grid.
        lines: shape [L, 6] [m].
    """
    cells = cell_misfits(fit, model.heights(lines)).cpu().numpy()
    scores = []
    for k, part in enumerate(model.each(lines).cpu().numpy()):
        near = scipy.ndimage.binary_dilation(part > 0, iterations=3)
        scores.append((float(cells[near].mean()) if near.any() else 0.0, k))
    return [k for _, k in sorted(scores, reverse=True)]
