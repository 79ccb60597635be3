"""Each end of each line alone, once lines explain an image nearly: where an end is hidden under other lines.

Little of the image shows such an end. What is wrong of it by a third of a millimetre is far below the noise of any
pixel, and a hundred times what the noise of all of them leaves open; on the way to where it belongs the misfit rises.
Three own plates of 24 lines had all other numbers right to 3 um: they were 0.57, 0.79 and 1.07 um off, and are 0.24,
0.32 and 0.28 at one wavelength with that end moved. And an end beyond the plate's edge shows nothing at all: one that
belongs 0.3 mm inside left a development field 0.31 um off, 18 at the edge, that is 0.13 with it.
"""

from collections.abc import Iterator, Sequence

import torch

from nets.reconstruct.fibres.image.descent import Fitted
from nets.reconstruct.fibres.image.image_fit import ImageFit
from nets.reconstruct.fibres.search.moves import SHORTEST_M, stretched
from nets.reconstruct.fibres.search.rounds import while_better

NEAR_M = 2.5e-4
"""First an end is moved by so much, both ways."""
HIDDEN_FACTOR = 1.05
"""An end of which that raises the misfit by no more than this factor is hidden; all others are where they belong."""
STRETCHES_M = (-1.6e-3, -1.1e-3, -8e-4, -5.5e-4, -4e-4, -1.2e-4, 1.2e-4, 4e-4, 5.5e-4, 8e-4, 1.1e-3, 1.6e-3)
"""By which a hidden end is moved, too."""
UNSEEN_FACTOR = 1.001
"""An end whose small move inward changes the misfit by no more than this factor lies where nothing shows it, as beyond
the plate's edge: nothing says how far away it belongs."""
INWARD_M = tuple(-1.5e-4 * k for k in range(1, 21))
"""By which such an end is moved. One that lay 1.45 mm too far out showed nothing 1.1 mm further in, and raised the
misfit by a sixth 1.6 mm further in: the valley between is a quarter of a millimetre wide."""
BETTER_FACTOR = 0.999
"""By which the misfit must fall before anything else has moved, for an end to be given a descent."""
TRIED = 3
"""Ends that are, those first of which it falls most."""
TRIAL_ITERATIONS = 12
"""Of L-BFGS of all lines."""
MOVED_FACTOR = 0.997
"""By which a descent must be below the same descent of lines as they are."""
ROUNDS = 3


def with_each_end(fit: ImageFit, lines: torch.Tensor, quick: ImageFit, *, with_section: bool = False) -> Fitted | None:
    """Lines with single ends moved along them, where the image likes it better; None where it does not.

    Args:
        fit: judges.
        lines: that explain the image nearly, shape [L, 6] [m].
        quick: says which ends may be elsewhere.
        with_section: descents move the model's section, too.
    """
    return while_better(lambda each: _once(fit, each, quick, with_section), lines, ROUNDS)


def _once(fit: ImageFit, lines: torch.Tensor, quick: ImageFit, with_section: bool) -> Fitted | None:
    ways = ends_elsewhere(quick, lines)
    if not ways:
        return None
    given = fit.model.shape
    as_they_are = fit.descend(lines, TRIAL_ITERATIONS, with_section=with_section).loss
    for moved in ways[:TRIED]:
        fit.model.shape = given
        found = fit.descend(moved, TRIAL_ITERATIONS, with_section=with_section)
        if found.loss < MOVED_FACTOR * as_they_are:
            return found
    fit.model.shape = given
    return None


def ends_elsewhere(quick: ImageFit, lines: torch.Tensor) -> list[torch.Tensor]:
    """Lines, each [L, 6] [m], with one end where the image likes it better, of each end that has such a place.

    Those first of which the misfit falls most.

    Args:
        quick: judges.
        lines: shape [L, 6] [m].
    """
    model, found = quick.model, list[tuple[float, int, torch.Tensor]]()
    quick.correct_at(model.heights(lines))
    now = quick.loss(model.heights(lines))
    for k, line in enumerate(lines):
        inward = list(_moved(line, (0, 2), (-NEAR_M,)))
        near = [*inward, *_moved(line, (0, 2), (NEAR_M,))]
        losses = _losses(quick, lines, k, [version for _, version in near])
        hidden = {end for (end, _), loss in zip(near, losses, strict=True) if loss < HIDDEN_FACTOR * now}
        if not hidden:
            continue
        # Outward an end may be at its limit.
        told = zip(inward, losses[: len(inward)], strict=True)
        unseen = sorted(end for (end, _), loss in told if abs(loss - now) < (UNSEEN_FACTOR - 1) * now)
        far = [*_moved(line, sorted(hidden), STRETCHES_M), *_moved(line, unseen, INWARD_M)]
        versions = near + far
        losses += _losses(quick, lines, k, [version for _, version in far])
        for end in hidden:
            least, number = min((loss, n) for n, loss in enumerate(losses) if versions[n][0] == end)
            if least < BETTER_FACTOR * now:
                moved = lines.clone()
                moved[k] = model.clamped(versions[number][1][None])[0]
                found.append((least, len(found), moved))
    return [moved for _, _, moved in sorted(found, key=lambda way: way[:2])]


def _moved(line: torch.Tensor, ends: Sequence[int], steps: tuple[float, ...]) -> Iterator[tuple[int, torch.Tensor]]:
    """Columns of ends, and a line [6] [m] with that end moved along."""
    length = float((line[2:4] - line[:2]).norm())
    return ((end, stretched(line, end, step)) for end in ends for step in steps if length + step > SHORTEST_M)


def _losses(fit: ImageFit, lines: torch.Tensor, k: int, versions: list[torch.Tensor]) -> list[float]:
    """Misfits of lines with line k in other versions."""
    if not versions:
        return []
    others = torch.cat([lines[:k], lines[k + 1 :]])
    return fit.losses_with_each(others, fit.model.clamped(torch.stack(versions)))
