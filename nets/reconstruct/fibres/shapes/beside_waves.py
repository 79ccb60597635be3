"""Lines beside the waves that were found along them: their ends, and those that only told waves.

Straight lines leave so much of a print that wavers that an end a millimetre away is little beside it, and short lines
across a wide one tell it where it is thicker: the search for lines ends there. With waves along them most of that is
told, and what is wrong of lines shows. So lines are mended with the waves as they are, as heights that are added, and
waves are found anew along what comes out.
"""

from collections.abc import Callable, Sequence

import torch

from nets.reconstruct.fibres.image.image_fit import ImageFit
from nets.reconstruct.fibres.search.ends import with_moved_ends
from nets.reconstruct.fibres.search.growth import pruned
from nets.reconstruct.fibres.search.joins import with_joins
from nets.reconstruct.fibres.search.moves import is_short, jump
from nets.reconstruct.fibres.search.rebuild import LINE_FACTOR
from warp_caustics.prints.model import LineModel

ROUNDS = {"cpu": 1, "cuda": 3}
"""Of mending, at most, by device: the first takes a CPU 15 to 25 s, and mends most."""
FACTOR = 0.97
"""The misfit must fall by this factor in each, lines counted, for lines and their waves to be taken."""
ITERATIONS = 20
"""Of L-BFGS of lines beside waves."""
JUMPING = 12
"""Lines that may jump."""


class BesideWaves(LineModel):
    """Lines and what waves add to their relief, which does not change; of the same shape.

    Args:
        model: renders lines.
        added_m: shape [n, n] [m].
    """

    def __init__(self, model: LineModel, added_m: torch.Tensor):
        vars(self).update(vars(model))
        self._added = added_m

    def joined(self, parts: torch.Tensor) -> torch.Tensor:
        """Relief of lines and what is added [m], shape [n, n], from each line alone, shape [L, n, n]."""
        return super().joined(parts) + self._added

    def without(self, parts: torch.Tensor, groups: Sequence[Sequence[int]]) -> torch.Tensor:
        """Reliefs of all lines but those of a group, and what is added; see :meth:`LineModel.without`."""
        found = super().without(parts, groups)
        return found + self._added if self.shape.overlap == 1 else found  # else of :meth:`joined`

    def with_each(self, lines: torch.Tensor, tried: torch.Tensor) -> torch.Tensor:
        """Reliefs of lines, each of others and what is added [m], shape [K, n, n]; see :meth:`LineModel.with_each`."""
        found = super().with_each(lines, tried)
        return found if self.shape.overlap == 1 else found + self._added  # else of :meth:`heights`

    def heights(self, lines: torch.Tensor) -> torch.Tensor:
        """Relief of all lines together and what is added [m], shape [n, n], float32."""
        found = super().heights(lines)
        return found if self.shape.overlap == 1 else found + self._added

    def with_jacobian(self, lines: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """The same with its derivatives [1] by all numbers, shape [P, n, n]."""
        found, derivatives = super().with_jacobian(lines)
        return (found if self.shape.overlap == 1 else found + self._added), derivatives


def mended(fit: ImageFit, quick: ImageFit, lines: torch.Tensor) -> list[torch.Tensor]:
    """Lines with ends and whole lines moved, shape [L, 6] [m]; and those of them that are longer than wide.

    Args:
        fit: judges, beside waves.
        quick: ranks what is tried.
        lines: shape [L, 6] [m].
    """
    found = pruned(fit, fit.descend(lines, ITERATIONS).lines)
    found = with_moved_ends(fit, with_joins(fit, found.lines, quick).lines, quick)
    moved, has_jumped = jump(fit, found.lines, JUMPING)
    if has_jumped:
        found = fit.descend(moved, ITERATIONS)
    is_long = torch.tensor([not is_short(line) for line in found.lines], dtype=torch.bool)
    return [found.lines] if is_long.all() or not is_long.any() else [found.lines, found.lines[is_long]]


def counted(loss: float, lines: int) -> float:
    """A misfit with what a line more must lower it by."""
    return loss * LINE_FACTOR**lines


Beside = Callable[[torch.Tensor], tuple[ImageFit, ImageFit]]
"""Of what waves add [m], shape [n, n]: misfits of lines beside it, at the pixels of the search and at fewer."""
