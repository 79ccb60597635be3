"""The same move tried on lines again and again, while it makes them better."""

from collections.abc import Callable

import torch

from nets.reconstruct.fibres.image.descent import Fitted


def while_better(move: Callable[[torch.Tensor], Fitted | None], lines: torch.Tensor, rounds: int) -> Fitted | None:
    """Lines after as many moves as were better; None if the first was not.

    Args:
        move: gives better lines than those it is given, shape [L, 6] [m], or None.
        lines: to begin with, shape [L, 6] [m].
        rounds: at most.
    """
    best: Fitted | None = None
    for _ in range(rounds):
        found = move(lines)
        if found is None:
            break
        best, lines = found, found.lines
    return best
