"""Robust least squares of lines to a relief: Levenberg-Marquardt on the Geman-McClure loss.

A network that finds reliefs is right to a few micrometres nearly everywhere and
wrong by a hundred where light paths cross. The loss z^2 / (1 + z^2), z being the
residual over its expected size, gives such places up, one unit each.
"""

import torch

from warp_caustics.prints.vectorise.model import LineModel

MAX_STEP = torch.tensor([1.5, 1.5, 1.5, 1.5, 0.5, 0.4], dtype=torch.float64)
"""Largest change in one iteration [mm]: from further away the derivatives tell nothing."""

_CONVERGED = 1e-4
_TRIALS = 6


def loss_of(residual_mm: torch.Tensor, sigma_mm: torch.Tensor) -> float:
    """Geman-McClure loss, summed.

    Args:
        residual_mm: shape [n, n].
        sigma_mm: expected size of the residual, shape [n, n].
    """
    squared = (residual_mm / sigma_mm).square()
    return float((squared / (1 + squared)).sum(dtype=torch.float64))


def fit_lines(
    model: LineModel,
    lines: torch.Tensor,
    relief_mm: torch.Tensor,
    sigma_mm: torch.Tensor,
    *,
    iterations: int = 20,
    only: list[int] | None = None,
) -> tuple[torch.Tensor, float]:
    """Lines moved so that they explain a relief.

    Args:
        model: renders lines.
        lines: where to start, shape [L, 6] [mm], float64.
        relief_mm: to be explained, shape [n, n] [mm].
        sigma_mm: expected size of what lines do not explain, shape [n, n] [mm].
        iterations: at most.
        only: indices of the lines to move; all if None.

    Returns:
        The lines and their loss.
    """
    lines = lines.clone()
    chosen = list(range(len(lines))) if only is None else only
    others = [k for k in range(len(lines)) if k not in set(chosen)]
    goal = relief_mm - model.heights(lines[others])
    if not chosen:
        return lines, loss_of(goal, sigma_mm)
    moving, damping = lines[chosen], 1e-2
    heights, derivatives = model.parts(moving)
    residual = goal - heights.sum(dim=0)
    loss = loss_of(residual, sigma_mm)
    for _ in range(iterations):
        weight = (1 + (residual / sigma_mm).square()).square().reciprocal() / sigma_mm.square()
        jacobian = derivatives.reshape(-1, residual.numel())
        weighted = jacobian * weight.reshape(1, -1)
        normal = (weighted @ jacobian.T).double().cpu()
        right = (weighted @ residual.reshape(-1)).double().cpu()
        scale = normal.diagonal() + 1e-9 * normal.diagonal().max() + 1e-12
        before = loss
        for _trial in range(_TRIALS):
            step = torch.linalg.solve(normal + damping * torch.diag(scale), right).reshape(-1, 6)
            tried = model.clamped(moving + torch.minimum(torch.maximum(step, -MAX_STEP), MAX_STEP))
            heights, found = model.parts(tried)
            rest = goal - heights.sum(dim=0)
            new = loss_of(rest, sigma_mm)
            if new < loss:
                moving, loss, residual, derivatives = tried, new, rest, found
                damping = max(damping / 5, 1e-6)
                break
            damping *= 6
        if before - loss <= _CONVERGED * before:
            break
    lines[chosen] = moving
    return lines, loss
