"""Gauss-Newton with Levenberg's and Marquardt's damping for a posterior: many pixels, few numbers, limits kept.

Minimises f(x) = sum rho(r(x)) + |x|^2 / 2, with Huber's rho of residuals in units of their noise, and x in units of
prior
widths (:mod:`warp_caustics.calibration.coordinates`). Steps are those of Nocedal and Wright (Numerical Optimization,
2006,
section 10.3) with Marquardt's scaling; what lies at a limit and is pushed out of it stays there (section 16.7).
"""

from collections.abc import Callable
from typing import NamedTuple, Protocol

import torch

from warp_caustics.errors import InputError

HUBER = 2.5
"""Residual [standard deviations] from which one counts linearly: dust and a fold that the model lacks pull no longer.
Of
Gaussian noise 1.2 % lies beyond."""
LARGEST_STEP = 3.0
"""Of a coordinate in one iteration [prior widths]."""
ENOUGH = 0.05
"""A step that promises less than this of the objective, a third of a standard deviation in one direction, is none."""
FIRST_DAMPING = 1e-3
MOST_TRIES = 8


class Normal(NamedTuple):
    """What the data say about x, to second order.

    Attributes:
        cost: sum of rho over the residuals.
        information: J^T W J, shape [P, P], float64.
        gradient: J^T W r, shape [P].
    """

    cost: float
    information: torch.Tensor
    gradient: torch.Tensor


class Problem(Protocol):
    """Data that depend on x."""

    def cost(self, x: torch.Tensor) -> float:
        """Sum of rho over the residuals.

        Raises:
            InputError: an x that describes no bench; the step is cut.
        """

    def normal(self, x: torch.Tensor) -> Normal:
        """The same with its derivatives."""


class Solution(NamedTuple):
    """Where the descent ended.

    Attributes:
        x: shape [P].
        cost: objective.
        information: of data and prior together, shape [P, P].
        is_held: whether a limit holds it, shape [P], bool.
        iterations: derivatives taken.
        is_converged: whether no step promised anything.
    """

    x: torch.Tensor
    cost: float
    information: torch.Tensor
    is_held: torch.Tensor
    iterations: int
    is_converged: bool


def huber(residuals: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """rho and the weight rho'(r) / r of residuals (Huber, Robust Statistics, 1981, eq. 4.4.12)."""
    size = residuals.abs()
    within = size <= HUBER
    rho = torch.where(within, residuals**2 / 2, HUBER * size - HUBER**2 / 2)
    return rho, torch.where(within, 1.0, HUBER / size.clamp_min(1e-300))


def minimised(
    problem: Problem,
    start: torch.Tensor,
    low: torch.Tensor,
    high: torch.Tensor,
    *,
    iterations: int = 12,
    watch: Callable[[int, float], None] | None = None,
) -> Solution:
    """The least f within limits.

    Args:
        problem: gives residuals' cost and derivatives.
        start: shape [P], within the limits.
        low: least x, shape [P].
        high: largest x, shape [P].
        iterations: derivatives taken, at most.
        watch: called with iteration and objective.
    """
    x = torch.minimum(torch.maximum(start.to(torch.float64), low), high)
    damping, converged, done = FIRST_DAMPING, False, 0
    found = problem.normal(x)
    while True:
        done += 1
        cost = found.cost + _prior(x)
        if watch is not None:
            watch(done, cost)
        total = found.information + torch.eye(len(x), dtype=torch.float64)
        gradient = found.gradient + x
        held = ((x <= low) & (gradient > 0)) | ((x >= high) & (gradient < 0))
        if done >= iterations or converged:
            return Solution(x, cost, total, held, done, converged)
        moved, damping, converged = _improved(problem, x, cost, total, gradient, ~held, (low, high), damping)
        if moved is None:
            return Solution(x, cost, total, held, done, converged)
        x = moved
        found = problem.normal(x)


def _prior(x: torch.Tensor) -> float:
    return float(x.square().sum()) / 2


def _improved(
    problem: Problem,
    x: torch.Tensor,
    cost: float,
    total: torch.Tensor,
    gradient: torch.Tensor,
    free: torch.Tensor,
    limits: tuple[torch.Tensor, torch.Tensor],
    damping: float,
) -> tuple[torch.Tensor | None, float, bool]:
    """A better x, the damping to go on with, and whether that was the last step worth taking; None if there is none."""
    if not bool(free.any()):
        return None, damping, True
    part, slope = total[free][:, free], gradient[free]
    diagonal = part.diagonal()
    for _ in range(MOST_TRIES):
        step = torch.zeros_like(x)
        step[free] = -torch.linalg.solve(part + damping * torch.diag(diagonal), slope)
        largest = float(step.abs().max())
        step = step * min(1.0, LARGEST_STEP / max(largest, 1e-300))
        trial = torch.minimum(torch.maximum(x + step, limits[0]), limits[1])
        actual = trial - x
        promised = -float(gradient @ actual + actual @ total @ actual / 2)
        if promised < ENOUGH and damping <= 1.0:
            return None, damping, True
        try:
            reached = problem.cost(trial) + _prior(trial)
        except InputError:
            reached = float("inf")
        if reached < cost:
            gained = cost - reached
            return trial, max(damping / 8, 1e-9), gained < ENOUGH
        damping *= 8
    return None, damping, False
