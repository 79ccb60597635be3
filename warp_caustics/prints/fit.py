"""Lines fitted to a relief by robust least squares.

By Levenberg-Marquardt on a robust loss rho(z) of z, the residual over its expected size (:func:`minimised`).
:func:`fit_lines` moves all numbers of lines that a search proposed; ``fit_design.py`` finds those of a design again. A
network that finds reliefs is right to a few micrometres nearly everywhere and wrong by a hundred where light paths
cross; the Geman-McClure loss z^2 / (1 + z^2) gives such places up, one unit each.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import torch

from warp_caustics.one_thread import one_thread
from warp_caustics.prints.fit_system import fit_system
from warp_caustics.prints.model import LineModel
from warp_caustics.prints.overlap import share

CONVERGED = 1e-4
"""Part of the loss; a step that gains less is the last."""
DAMPING_TRIALS = 6
LARGER_GAINS = 2.0
"""Times its last gain, more than which an iteration is not expected to gain: gains fall, but for the first few."""


@dataclass(frozen=True)
class RobustLoss:
    """rho(z) of a residual z in units of its expected size.

    Attributes:
        value: rho, of z^2.
        weight: rho'(z) / z, of z^2: how much a residual counts in the normal equations.
    """

    value: Callable[[torch.Tensor], torch.Tensor]
    weight: Callable[[torch.Tensor], torch.Tensor]


GEMAN_MCCLURE = RobustLoss(lambda squared: squared / (1 + squared), lambda squared: 2 / (1 + squared).square())
CHARBONNIER = RobustLoss(lambda squared: (1 + squared).sqrt() - 1, lambda squared: (1 + squared).rsqrt())


System = Callable[[torch.Tensor], tuple[float | torch.Tensor, torch.Tensor, torch.Tensor]]
"""Of parameters, of any shape with P numbers: loss, normal matrix J W J^T [P, P] and right side J W residual [P], on
the CPU in float64; W = rho'(z) / (z sigma^2)."""


def normal_equations(
    with_jacobian: Callable[[torch.Tensor], tuple[torch.Tensor, torch.Tensor]],
    relief_m: torch.Tensor,
    sigma_m: torch.Tensor,
    loss: RobustLoss,
) -> System:
    """Those of sum rho((relief - h(x)) / sigma) by iteratively re-weighted least squares.

    Args:
        with_jacobian: of parameters: h [m], shape [n, n], and J = dh/dx, shape [P, n, n].
        relief_m: to be explained, shape [n, n].
        sigma_m: expected size of what is not explained, shape [n, n].
        loss: rho.
    """
    inverse_variance = sigma_m.square().reciprocal()

    def system(parameters: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """A GPU is waited for once."""
        count = parameters.numel()
        relief, derivatives = with_jacobian(parameters)
        residual = relief_m - relief
        squared = residual.square() * inverse_variance
        jacobian = derivatives.reshape(count, -1)
        weighted = jacobian * (loss.weight(squared) * inverse_variance).reshape(1, -1)
        told = (
            (weighted @ jacobian.T).double().flatten(),
            (weighted @ residual.reshape(-1)).double(),
            loss.value(squared).sum(dtype=torch.float64)[None],
        )
        normal, right, value = torch.cat(told).cpu().split((count * count, count, 1))
        return value, normal.reshape(count, count), right

    return system


def minimised(
    system: System,
    moved: Callable[[torch.Tensor, torch.Tensor], torch.Tensor],
    start: torch.Tensor,
    *,
    iterations: int,
    held: torch.Tensor | None = None,
    below: float = math.inf,
) -> tuple[torch.Tensor, float]:
    """Parameters x that minimise a robust loss + sum held (x - start)^2 / 2, from a start.

    Levenberg-Marquardt: (J W J^T + damping diag) step = J W residual. See Nocedal & Wright, Numerical Optimization,
    section 10.3.

    Args:
        system: normal equations of the loss.
        moved: of parameters and a step, shape [P]: parameters within their limits.
        start: parameters, of any shape with P numbers, float64, on the CPU.
        iterations: at most.
        held: one over the squared distance that each parameter may go from its start, shape [P]; free if None.
        below: loss that is asked for; given up where what is left of the iterations will not come so far.

    Returns:
        Parameters and their loss.
    """

    def told(parameters: torch.Tensor) -> tuple[float, torch.Tensor, torch.Tensor]:
        value, normal, right = system(parameters)
        if held is None:
            return float(value), normal, right
        apart = (parameters - start).reshape(-1)
        strain = float((held * apart.square()).sum()) / 2
        return float(value) + strain, normal + torch.diag(held), right - held * apart

    found, damping = start, 1e-2
    least, normal, right = told(found)
    for left in reversed(range(iterations)):
        diagonal = normal.diagonal()
        scale = diagonal + 1e-9 * diagonal.max() + 1e-12
        before = least
        for _trial in range(DAMPING_TRIALS):
            with one_thread():
                step = torch.linalg.solve(torch.diagonal_scatter(normal, diagonal + damping * scale), right)
            tried = moved(found, step)
            new, normal_there, right_there = told(tried)
            if new < least:
                found, least, normal, right = tried, new, normal_there, right_there
                damping = max(damping / 5, 1e-6)
                break
            damping *= 6
        gain = before - least
        if gain <= CONVERGED * before or least - LARGER_GAINS * gain * left > below:
            break
    return found, least


def _loss(loss: RobustLoss, residual_m: torch.Tensor, sigma_m: torch.Tensor) -> float:
    return float(loss.value((residual_m / sigma_m).square()).sum(dtype=torch.float64))


def loss_of(residual_m: torch.Tensor, sigma_m: torch.Tensor) -> float:
    """Geman-McClure loss of :func:`fit_lines`, summed.

    Args:
        residual_m: shape [n, n].
        sigma_m: expected size of the residual, shape [n, n].
    """
    return _loss(GEMAN_MCCLURE, residual_m, sigma_m)


def fit_lines(
    model: LineModel,
    lines: torch.Tensor,
    relief_m: torch.Tensor,
    sigma_m: torch.Tensor,
    *,
    iterations: int = 20,
    only: list[int] | None = None,
    below: float = math.inf,
    others_m: torch.Tensor | None = None,
) -> tuple[torch.Tensor, float]:
    """Lines moved so that they explain a relief but for a few wrong places.

    Args:
        model: renders lines.
        lines: where to start, shape [L, 6] [m], float64.
        relief_m: to be explained, shape [n, n], float32, on the model's device.
        sigma_m: expected size of what lines do not explain, shape [n, n], likewise.
        iterations: at most.
        only: indices of the lines to move; all if None.
        below: loss that is asked for, see :func:`minimised`.
        others_m: relief of the lines that do not move, shape [n, n] [m], where it is known.

    Returns:
        The lines and their loss, see :func:`loss_of`.
    """
    lines = lines.clone()
    chosen = list(range(len(lines))) if only is None else only
    if others_m is None:
        others = sorted(set(range(len(lines))).difference(chosen))
        others_m = model.heights(lines[others]) if others else torch.zeros_like(relief_m)
    if not chosen:
        return lines, loss_of(relief_m - others_m, sigma_m)
    printed = others_m

    def over_others(rows: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        relief, derivatives = model.with_jacobian(rows)
        together, q = model.over(printed, relief), model.shape.overlap
        return together, derivatives if q == 1 else derivatives * share(relief, together, q)

    with fit_system(model, len(chosen), is_each=False) as kept:
        if kept is None:
            system = normal_equations(over_others, relief_m, sigma_m, GEMAN_MCCLURE)
        else:
            kept.about(relief_m, sigma_m, printed)
            system = partial(kept, model)
        lines[chosen], loss = minimised(system, model.moved, lines[chosen], iterations=iterations, below=below)
    return lines, loss
