"""Few lines fitted to an image while all others stay where they are: few numbers, for a part of the time."""

import copy

import torch

from nets.reconstruct.fibres.image.descent import Fitted
from nets.reconstruct.fibres.image.image_fit import ImageFit
from warp_caustics.prints.model import LineModel


class LinesOnOthers(LineModel):
    """Lines printed over others that do not change, of the same shape.

    Args:
        model: renders both.
        others: shape [L, 6] [m].
    """

    def __init__(self, model: LineModel, others: torch.Tensor):
        vars(self).update(vars(model))
        self._others = model.heights(others)
        self._others_points = None if model.shape.overlap == 1 else model.points(others)

    def points(self, lines: torch.Tensor, others_m: torch.Tensor | None = None) -> torch.Tensor:
        """What is printed at the points of each cell, others and all [m]; see :meth:`LineModel.points`."""
        return super().points(lines, self._others_points if others_m is None else others_m)

    def joined(self, parts: torch.Tensor) -> torch.Tensor:
        """Relief of lines and the others [m], shape [n, n], from each line alone, shape [L, n, n]."""
        return self.over(super().joined(parts), self._others) if len(parts) else self._others


def descended(fit: ImageFit, lines: torch.Tensor, moving: list[int], iterations: int) -> Fitted:
    """Lines of which some have moved to explain the image better; never worse.

    Args:
        fit: judges.
        lines: shape [L, 6] [m].
        moving: indices of those that move; these come last in what is found.
        iterations: of L-BFGS, at most.
    """
    others = [k for k in range(len(lines)) if k not in moving]
    beside = copy.copy(fit)
    beside.model = LinesOnOthers(fit.model, lines[others])
    found = beside.descend(lines[moving], iterations)
    return Fitted(torch.cat([lines[others], found.lines]), found.loss)
