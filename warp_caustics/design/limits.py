"""Heights within exact limits, without a kink: the last part of the way up and down is compressed."""

import torch

MARGIN = 0.05
"""Share of the height limit, at either end, over which heights are compressed."""


def bounded(free: torch.Tensor, limit_m: float) -> torch.Tensor:
    """Free heights [m] mapped between 0 and a limit [m].

    Unchanged but for the last twentieth at either end, which takes all that is beyond by a hyperbolic tangent.
    """
    margin = MARGIN * limit_m
    low, high = margin, limit_m - margin
    above, below = torch.relu(free - high), torch.relu(low - free)
    inside = free.clamp(low, high)
    return inside + margin * (torch.tanh(above / margin) - torch.tanh(below / margin))
