"""Heights that are not known either, in few numbers: what they take from an image's knowledge of the set-up."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from warp_caustics.errors import InputError
from warp_caustics.height_field import MARGIN, basis_matrix
from warp_caustics.prints.line import Line, Section
from warp_caustics.prints.model import LINE_COLUMNS, LineModel, rows_of
from warp_caustics.scene import Scene

LARGEST_GRID = 32
HEIGHT_PRIOR_M = 2e-5
"""Of a smooth change of the relief [m]: what a print misses its design by."""
LINE_PRIORS_M = (1e-4, 1e-4, 1e-4, 1e-4, 1e-4, 3e-5)
"""Of a printed line's numbers (LINE_COLUMNS) [m]: ends and width to 0.1 mm, height to 30 um."""


@dataclass(frozen=True, eq=False)
class UnknownHeights:
    """A linear model of what is not known about heights.

    Attributes:
        names: of its numbers, K of them, all of them lengths [m].
        modes: change of heights per unit [1], shape [K, n, n], float64.
        priors: standard deviations [m], shape [K].
    """

    names: tuple[str, ...]
    modes: torch.Tensor
    priors: torch.Tensor


def smooth_heights(scene: Scene, grid: int, prior_m: float = HEIGHT_PRIOR_M) -> UnknownHeights:
    """Any smooth change of the relief: cubic B-splines on a coarse grid over the plate, which sum to 1.

    Args:
        scene: gives n.
        grid: knots along an axis; 1 is a change of all heights alike, which is one of the base.
        prior_m: standard deviation of each coefficient [m].

    Raises:
        InputError: a grid of no size.
    """
    if not 1 <= grid <= LARGEST_GRID:
        raise InputError(f"grid of {grid} x {grid} heights is not between 1 and {LARGEST_GRID}; 4 is a smooth change")
    n = scene.height_samples
    coordinate = (np.arange(n) + 0.5) / n * grid - 0.5
    values = torch.from_numpy(basis_matrix(grid, coordinate, 0))  # [n, grid + 4]
    # Splines beyond the plate belong to the outermost ones, so that each place is covered fully.
    along = torch.zeros(n, grid, dtype=torch.float64)
    along.index_add_(1, torch.arange(-MARGIN, grid + MARGIN).clamp(0, grid - 1), values)
    modes = torch.einsum("ik,jl->klij", along, along).flatten(0, 1)
    names = tuple(f"height.{row}.{column}" for row in range(grid) for column in range(grid))
    return UnknownHeights(names, modes, torch.full((grid * grid,), prior_m, dtype=torch.float64))


def line_heights(scene: Scene, lines: Sequence[Line], section: Section = "cosine") -> UnknownHeights:
    """Ends, width and height of each printed line: derivatives of the relief by them.

    Args:
        scene: gives plate and samples.
        lines: of the plate, at least one.
        section: of the lines.

    Raises:
        InputError: no line.
    """
    if not lines:
        raise InputError("no lines, so nothing of them is unknown; give at least one")
    _, modes = LineModel(scene, section).with_jacobian(rows_of(lines))
    names = tuple(f"line.{k}.{column}" for k in range(len(lines)) for column in LINE_COLUMNS)
    priors = torch.tensor(LINE_PRIORS_M * len(lines), dtype=torch.float64)
    return UnknownHeights(names, modes.to(torch.float64), priors)
