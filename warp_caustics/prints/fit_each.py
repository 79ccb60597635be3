"""Many lines fitted to a relief, each for itself, in one batch: which of them is the best start?

The same descent as :func:`warp_caustics.prints.fit.fit_lines` of single lines; a GPU waits for the host once for all.
"""

import math
from collections.abc import Callable
from functools import partial

import numpy as np
import torch

from warp_caustics.prints.fit import CONVERGED, GEMAN_MCCLURE, LARGER_GAINS
from warp_caustics.prints.fit_system import FitSystem, fit_system
from warp_caustics.prints.model import LineModel
from warp_caustics.prints.overlap import share
from warp_caustics.types import FloatArray, IntArray

DAMPING_START, DAMPING_UP, DAMPING_DOWN, DAMPING_LEAST = 1e-2, 6.0, 5.0, 1e-6
TRIALS_PER_ITERATION = 1.5
"""Steps tried, over the iterations asked for: some are refused."""


_Told = tuple[torch.Tensor, torch.Tensor, torch.Tensor]
System = Callable[[torch.Tensor, torch.Tensor], _Told]
"""Of all lines [L, 6], and which of them are asked for [K]: their losses [K], normal matrices [K, 6, 6] and right sides
[K, 6], on the CPU."""


def fit_each(
    model: LineModel,
    lines: torch.Tensor,
    relief_m: torch.Tensor,
    sigma_m: torch.Tensor,
    *,
    iterations: int,
    printed_m: torch.Tensor | None = None,
    below: float = math.inf,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Each of the lines moved so that it explains a relief but for a few wrong places, without the others.

    Levenberg-Marquardt with iteratively re-weighted least squares, a damping for each line.

    Args:
        model: renders lines.
        lines: where to start, shape [L, 6] [m], float64.
        relief_m: to be explained, shape [n, n], float32, on the model's device.
        sigma_m: expected size of what lines do not explain, shape [n, n], likewise.
        iterations: of each line, at most.
        printed_m: what is printed beside each line, shape [L, n, n]; nothing if None.
        below: loss that is asked for; lines that will not come so far are left where they are.

    Returns:
        The lines, shape [L, 6] [m], and their Geman-McClure losses, shape [L], on the CPU.
    """
    if not len(lines):
        return lines.clone(), torch.zeros(0, dtype=torch.float64)
    with fit_system(model, len(lines), is_each=True) as kept:
        if kept is None:
            system = _each_alone(model, relief_m, sigma_m, printed_m)
        else:
            kept.about(relief_m, sigma_m, printed_m)
            system = partial(_some_of, kept, model)
        return _minimised(system, model, lines, iterations, below)


def _some_of(kept: FitSystem, model: LineModel, lines: torch.Tensor, of: torch.Tensor) -> _Told:
    loss, normal, right = kept(model, lines)
    return loss[of], normal[of], right[of]


def _each_alone(
    model: LineModel, relief_m: torch.Tensor, sigma_m: torch.Tensor, printed_m: torch.Tensor | None
) -> System:
    """The normal equations of each line for itself, a launch after the other."""
    inverse_variance = sigma_m.square().reciprocal()

    def system(lines: torch.Tensor, of: torch.Tensor) -> _Told:
        parts, derivatives = model.parts(lines[of])
        if printed_m is not None:
            beside = printed_m[of.to(printed_m.device)]
            together = model.over(beside, parts)
            if model.shape.overlap != 1:
                derivatives = derivatives * share(parts, together, model.shape.overlap)[:, None]
            parts = together
        residual = relief_m - parts
        squared = residual.square() * inverse_variance
        loss = GEMAN_MCCLURE.value(squared).flatten(1).sum(dim=1, dtype=torch.float64)
        weight = GEMAN_MCCLURE.weight(squared) * inverse_variance
        jacobian = derivatives.flatten(2)
        weighted = jacobian * weight.flatten(1)[:, None]
        normal = weighted @ jacobian.transpose(1, 2)
        right = (weighted @ residual.flatten(1)[..., None])[..., 0]
        together = torch.cat([loss[:, None], normal.flatten(1).double(), right.double()], dim=1).cpu()
        return together[:, 0], together[:, 1:37].reshape(-1, 6, 6), together[:, 37:]

    return system


def _minimised(
    system: System, model: LineModel, lines: torch.Tensor, iterations: int, below: float
) -> tuple[torch.Tensor, torch.Tensor]:
    """Small arrays by NumPy, which takes a fifth of the time for them that torch does."""

    def told(rows: FloatArray, of: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        loss, normal, right = system(torch.from_numpy(rows), torch.from_numpy(of))
        return loss.numpy(), normal.numpy(), right.numpy()

    found = lines.numpy().copy()
    damping, active = np.full(len(found), DAMPING_START), np.ones(len(found), dtype=bool)
    least, normal, right = (each.copy() for each in told(found, np.arange(len(found))))
    for left in reversed(range(round(TRIALS_PER_ITERATION * iterations))):
        chosen = active.nonzero()[0]
        if not len(chosen):
            break
        damped = normal[chosen]
        diagonal = np.einsum("kii->ki", damped)
        scale = diagonal + 1e-9 * diagonal.max(axis=1, keepdims=True) + 1e-12
        diagonal += damping[chosen, None] * scale
        step = np.linalg.solve(damped, right[chosen, :, None])
        tried = found.copy()
        tried[chosen] = model.moved(torch.from_numpy(found[chosen]), torch.from_numpy(step.reshape(-1))).numpy()
        loss, normal_there, right_there = told(tried, chosen)
        is_better, gain = loss < least[chosen], least[chosen] - loss
        is_last = is_better & ((gain <= CONVERGED * least[chosen]) | (loss - LARGER_GAINS * gain * left > below))
        better = chosen[is_better]
        found[better], least[better] = tried[better], loss[is_better]
        normal[better], right[better] = normal_there[is_better], right_there[is_better]
        damping[better] = np.maximum(damping[better] / DAMPING_DOWN, DAMPING_LEAST)
        damping[chosen[~is_better]] *= DAMPING_UP
        active[chosen[is_last]] = False
        active &= damping < DAMPING_UP**6
    return torch.from_numpy(found), torch.from_numpy(least)
