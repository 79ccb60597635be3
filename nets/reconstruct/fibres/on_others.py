"""Few lines fitted to an image while all others stay where they are: few numbers, for a part of the time."""

import copy

import torch

from nets.reconstruct.fibres.image_fit import Fitted, ImageFit
from warp_caustics.prints.model import LineModel


class LinesOnOthers(LineModel):
    """Lines printed over others that do not change, of the same shape.

    Args:
        model: renders both.
        others_m: relief of the others [m], shape [n, n].
    """

    def __init__(self, model: LineModel, others_m: torch.Tensor):
        vars(self).update(vars(model))
        self._others = others_m

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
    beside.model = LinesOnOthers(fit.model, fit.model.heights(lines[others]))
    found = beside.descend(lines[moving], iterations)
    return Fitted(torch.cat([lines[others], found.lines]), found.loss)
