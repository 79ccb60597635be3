"""The lines with corners and curves that a relief was printed with."""

import numpy as np
import torch

from warp_caustics.prints.fit import loss_of
from warp_caustics.prints.model import LineModel
from warp_caustics.prints.smooth_chains import track_through
from warp_caustics.prints.vectorise.curved_lines import CurvedLines
from warp_caustics.prints.vectorise.curved_set import CurvedSet
from warp_caustics.prints.vectorise.lines import FLOORS_M as FLOORS_OF_LINES_M
from warp_caustics.prints.vectorise.lines import lines_of_relief

BEGINNINGS_M = (3e-4, 1e-4), (1e-4,)
"""Expected size of residuals on bare plate in one stage after the other [m]. Two ways to begin: with the first, lines
that lie on top of each other are told apart; with the second, thin ones are not lost beside high ones. What leaves less
is taken."""
STRAIGHT_NODE_M = 4e-4
"""Distance of the points that a straight line is followed by [m]."""
FLOORS_M = (3e-5,)
"""And after that."""
LAST_FLOOR_M = 8e-6
"""In the last fit, when no line is added any more."""
MOST_LINES = 40
NODE_LOSS = 2.0
"""Of a node, where these lines are compared with straight ones, each of which counts 20 for six numbers."""
ROUNDS = 3
FIRST_ITERATIONS, LATER_ITERATIONS, LAST_ITERATIONS = 30, 20, 60
"""Of L-BFGS with all lines."""


def curved_lines_of_relief(
    model: LineModel,
    relief_m: torch.Tensor,
    spread_m: torch.Tensor,
    *,
    most: int = MOST_LINES,
    start: CurvedLines | None = None,
) -> CurvedLines:
    """Few lines that explain a relief but for places where it is uncertain.

    Args:
        model: of straight lines, with the section and overlap of these.
        relief_m: heights [m], shape [n, n].
        spread_m: how far they may be wrong [m], shape [n, n].
        most: number of lines at most.
        start: lines that are nearly right.
    """
    nothing, tried = CurvedLines([], np.zeros((0, 2))), []
    ways: list[tuple[tuple[float, ...], CurvedLines]] = [(floors, nothing) for floors in BEGINNINGS_M]
    if start is not None:
        ways = [((), start)]
    for floors, first in ways:
        found = CurvedSet(model, relief_m, spread_m)
        found.begin(first)
        for floor in (*floors, *FLOORS_M):
            _stage(found, floor, most)
        found.focus(LAST_FLOOR_M)
        found.refit(LAST_ITERATIONS)
        tried.append((found.worth, found.lines))
    return min(tried, key=lambda each: each[0])[1]


def straight_lines(
    model: LineModel, relief_m: torch.Tensor, spread_m: torch.Tensor, most: int = MOST_LINES
) -> CurvedLines:
    """Straight lines that explain a relief, with nodes of their own: where lines with corners and curves may begin.

    Ridges of lines that cross at a small angle, such as rows of two meanders, lead from one to the other. Straight
    lines go on there, and what consists of them is told by these, whose ends are joined.

    Args:
        model: of straight lines, with their section and overlap.
        relief_m: heights [m], shape [n, n].
        spread_m: how far they may be wrong [m], shape [n, n].
        most: number of lines at most.
    """
    rows = lines_of_relief(model, relief_m, spread_m, most=most).numpy()
    lengths = np.hypot(*(rows[:, 2:4] - rows[:, :2]).T)
    ways = [
        track_through(np.linspace(row[:2], row[2:4], max(2, int(length / STRAIGHT_NODE_M))))
        for row, length in zip(rows, lengths, strict=True)
    ]
    return CurvedLines(ways, rows[:, 4:].copy())


def refitted_curves(
    model: LineModel, lines: CurvedLines, relief_m: torch.Tensor, spread_m: torch.Tensor
) -> tuple[CurvedLines, float]:
    """Lines moved to tell a relief as well as the model's section lets them, and what they leave of it.

    Args:
        model: of straight lines, with the section and overlap of these.
        lines: nearly right.
        relief_m: heights [m], shape [n, n].
        spread_m: how far they may be wrong [m], shape [n, n].
    """
    found = CurvedSet(model, relief_m, spread_m)
    found.begin(lines)
    for floor in (*FLOORS_M, LAST_FLOOR_M):
        found.focus(floor)
        found.refit(FIRST_ITERATIONS)
    return found.lines, found.state.loss


def curved_unexplained(model: LineModel, lines: CurvedLines, relief_m: torch.Tensor, spread_m: torch.Tensor) -> float:
    """What lines leave of a relief, with a penalty for each node: compares with what straight ones leave.

    Args:
        model: of straight lines, with the section and overlap of these.
        lines: any number.
        relief_m: heights [m], shape [n, n].
        spread_m: how far they may be wrong [m], shape [n, n].
    """
    found = CurvedSet(model, relief_m, spread_m)
    found.begin(lines)
    fit = found.fit
    sigma = (fit.spread.square() + FLOORS_OF_LINES_M[-1] ** 2).sqrt()
    nodes = sum(len(track.nodes_m) for track in lines.tracks)
    return loss_of(fit.relief - model.joined(found.state.parts), sigma) + NODE_LOSS * nodes


def _stage(found: CurvedSet, floor_m: float, most: int) -> None:
    """Lines for residuals of a size."""
    found.focus(floor_m)
    found.refit(FIRST_ITERATIONS)
    for _ in range(ROUNDS):
        has_grown = found.grow(most)
        if has_grown:
            found.refit(FIRST_ITERATIONS)
        has_split = found.split(most)
        if has_split:
            found.refit(LATER_ITERATIONS)
        has_pruned = found.prune()
        if not (has_grown or has_split or has_pruned):
            break
    if found.rebuild(most):
        found.refit(LATER_ITERATIONS)
        found.prune()
    found.link()
    if found.unstack():
        found.link()
    found.refit(LATER_ITERATIONS)
