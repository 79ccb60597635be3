"""The lines that a relief was printed with."""

import torch

from warp_caustics.prints.fit import fit_lines, loss_of
from warp_caustics.prints.model import LineModel
from warp_caustics.prints.vectorise.moves import LINE_PENALTY, LineSet

FLOORS_M = (3e-4, 1e-4, 4e-5, 1e-5, 4e-6)
"""Expected size of residuals on bare plate in one stage after the other [m]: large ones first, so that early lines are
not bent to explain what later ones will. They begin near the height of prints: residuals far above are given up by the
robust loss, and where several lines lie on top of each other those that are not yet there leave nothing else. Begun at
4e-5, crowded plates ended with a third of their lines missing: exact reliefs of 14 to 25 ellipses 305, 48, 0 and 188 um
off, now 48, 18, 0 and 0; with 1.6e-4 for the first two 78, 19, 28 and 0. It takes 1.4 times as long."""
MOST_LINES = 60
ROUNDS = 4


def lines_of_relief(
    model: LineModel, relief_m: torch.Tensor, spread_m: torch.Tensor, *, most: int = MOST_LINES
) -> torch.Tensor:
    """Few lines that explain a relief but for places where it is uncertain.

    Greedy: a line is added along the highest unexplained ridge, all are fitted, again; then lines that continue each
    other are joined, superfluous ones removed, and the residuals that count as explained shrink.

    Args:
        model: renders lines.
        relief_m: heights [m], shape [n, n].
        spread_m: how far they may be wrong [m], shape [n, n].
        most: number of lines at most.

    Returns:
        Lines, shape [L, 6] (LINE_COLUMNS) [m], float64, on the CPU.
    """
    relief, spread = (values.to(model.device, torch.float32) for values in (relief_m, spread_m))
    found = LineSet(model, relief, spread)
    for floor in FLOORS_M:
        found.focus(floor)
        for _ in range(ROUNDS):
            if found.grow(most):
                found.refit(20)
            count = len(found.lines)
            found.merge()
            found.prune()
            if len(found.lines) == count:
                break
    return fit_lines(model, found.lines, relief, found.sigma, iterations=15)[0]


def unexplained(model: LineModel, lines: torch.Tensor, relief_m: torch.Tensor, spread_m: torch.Tensor) -> float:
    """What lines leave of a relief, with a penalty for each: the less, the better they tell it.

    Args:
        model: renders lines.
        lines: shape [L, 6] [m].
        relief_m: heights [m], shape [n, n].
        spread_m: how far they may be wrong [m], shape [n, n].
    """
    relief, spread = (values.to(model.device, torch.float32) for values in (relief_m, spread_m))
    sigma = (spread.square() + FLOORS_M[-1] ** 2).sqrt()
    return loss_of(relief - model.heights(lines), sigma) + LINE_PENALTY * len(lines)
