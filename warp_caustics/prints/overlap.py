"""What is printed where lines cross, of their heights h_i >= 0 [m]: H = (sum h_i^p)^(1/p), p = 1 / q.

q = 1 adds them up, q = 0 takes the highest; between them lines merge. Derivatives dH/dh_i = (h_i / H)^(p - 1).
:func:`data_gen.variety.merged` is the same in double precision.
"""

import torch

LEAST = 0.02
"""q below which the highest is taken: a power of 50 and more is that in single precision, but for 1.4 %."""
TINY_M = 1e-12
"""Height that is none [m]."""


def joined(parts: torch.Tensor, q: float) -> torch.Tensor:
    """Relief of lines [m], shape [n, n], from each alone, shape [L, n, n]."""
    if q == 1 or not len(parts):
        return parts.sum(dim=0)
    highest = parts.amax(dim=0)
    if q < LEAST:
        return highest
    # Relative to the highest, so that no power is too small or too large for single precision.
    relative = parts / highest.clamp_min(TINY_M)
    return highest * relative.pow(1 / q).sum(dim=0).pow(q)


def over(heights: torch.Tensor, others: torch.Tensor, q: float) -> torch.Tensor:
    """Lines printed over others [m]; shapes that broadcast."""
    if q == 1:
        return heights + others
    highest = torch.maximum(heights, others)
    if q < LEAST:
        return highest
    lower = torch.minimum(heights, others).clamp_min(0.0) / highest.clamp_min(TINY_M)
    return highest * (1 + lower.pow(1 / q)).pow(q)


def share(parts: torch.Tensor, total: torch.Tensor, q: float) -> torch.Tensor:
    """dH/dh_i [1] of parts in a relief of them and others [m], shapes that broadcast; at q = 0 of all highest ones."""
    if q < LEAST:
        return (parts >= total).to(parts.dtype)
    return (parts / total.clamp_min(TINY_M)).clamp(0.0, 1.0).pow(1 / q - 1)


def relief_of(alone: torch.Tensor, q: float) -> torch.Tensor:
    """Relief of lines [m], shape [n, n], from each alone, shape [L, n, n], or at points of cells, [L, n, n, points].

    The latter is what is printed: where lines cross, the mean over a cell is not what is printed of the means.
    """
    total = joined(alone, q)
    return total.mean(dim=-1) if alone.ndim == 4 else total


def by_each(by_height: torch.Tensor, alone: torch.Tensor, q: float) -> torch.Tensor:
    """Gradient by each line alone, shape of ``alone``, from that by the relief, shape [n, n]; see :func:`relief_of`."""
    if alone.ndim == 4:
        by_height = by_height[..., None] / alone.shape[-1]
    of_each = by_height.expand_as(alone)
    return of_each if q == 1 else of_each * share(alone, joined(alone, q), q)
