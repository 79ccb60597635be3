"""Many small descents that are independent of each other, evaluated together.

Each is L-BFGS within bounds: the direction is of the numbers that are not held by a bound, and a step is shortened
until the loss falls enough. SciPy does one after the other, each evaluation by itself, which on a GPU is waiting.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from warp_caustics.types import BoolArray, FloatArray

MEMORY = 12
"""Changes that are remembered."""
SUFFICIENT = 1e-4
"""Share of what the slope promises by which the loss must fall (Armijo)."""
LEAST_CURVATURE = 1e-10
"""Of a change, relative to its length and the gradient's, to be remembered."""
SHORTEST, LONGEST = 0.1, 0.5
"""Shares of a step that failed that the next one may have."""
FAILURES = 20
"""Of steps, one after the other, from which on a descent is over."""


@dataclass(frozen=True, eq=False)
class Descended:
    """Where descents ended.

    Attributes:
        numbers: shape [B, D].
        losses: there, shape [B].
        evaluations: of all together.
    """

    numbers: FloatArray
    losses: FloatArray
    evaluations: int


def descend_side_by_side(
    objective: Callable[[FloatArray], tuple[FloatArray, FloatArray]],
    start: FloatArray,
    low: FloatArray,
    high: FloatArray,
    *,
    iterations: int,
    converged: float,
) -> Descended:
    """Least losses of B functions of D numbers each; no worse than where they begin.

    Args:
        objective: losses, shape [B], and gradients, shape [B, D], of numbers of shape [B, D]. Where a function has
            fewer than D numbers the gradient by the others is 0.
        start: within the bounds, shape [B, D].
        low: bounds, shape [B, D]; infinite for none.
        high: bounds, shape [B, D].
        iterations: of each, at most.
        converged: a descent is over where an iteration lowers the loss by no more than this share.
    """
    at, count, evaluations = np.array(start, np.float64), len(start), 1
    losses, gradients = objective(at)
    memory = _Memory(count)
    active, taken, failed = np.ones(count, bool), np.zeros(count, int), np.zeros(count, int)
    directions = _directions(memory, at, gradients, low, high)
    steps = np.minimum(1.0, 1.0 / np.maximum(np.linalg.norm(directions, axis=1), 1e-300))
    for _ in range(int(1.3 * iterations) + 2):
        slopes = (directions * gradients).sum(axis=1)
        active &= (slopes < 0) & (taken < iterations) & (failed < FAILURES)
        if not active.any():
            break
        tried = np.clip(at + (steps * active)[:, None] * directions, low, high)
        new_losses, new_gradients = objective(tried)
        evaluations += 1
        promised = (gradients * (tried - at)).sum(axis=1)
        falls = active & (new_losses <= losses + SUFFICIENT * np.minimum(promised, 0.0)) & (promised < 0)
        failing = active & ~falls
        # The parabola through the loss, its slope and the loss that was reached has its least value there.
        above = new_losses - losses - promised
        parabola = np.where(above > 0, -promised / (2 * np.maximum(above, 1e-300)), LONGEST)
        steps = np.where(failing, steps * np.clip(parabola, SHORTEST, LONGEST), 1.0)
        failed = np.where(failing, failed + 1, 0)
        scale = np.maximum(np.maximum(np.abs(losses), np.abs(new_losses)), 1.0)
        done = falls & (losses - new_losses <= converged * scale)
        memory.remember(falls, tried - at, new_gradients - gradients)
        at, gradients = np.where(falls[:, None], tried, at), np.where(falls[:, None], new_gradients, gradients)
        losses, taken = np.where(falls, new_losses, losses), taken + falls
        active &= ~done
        directions = np.where(falls[:, None], _directions(memory, at, gradients, low, high), directions)
    return Descended(at, losses, evaluations)


def _directions(
    memory: "_Memory", at: FloatArray, gradients: FloatArray, low: FloatArray, high: FloatArray
) -> FloatArray:
    """Of descent, shape [B, D]; 0 for numbers at a bound that the gradient drives out."""
    held = ((at <= low) & (gradients > 0)) | ((at >= high) & (gradients < 0))
    found = -memory.times(np.where(held, 0.0, gradients))
    found = np.where(held, 0.0, found)
    uphill = (found * gradients).sum(axis=1) >= 0
    return np.where(uphill[:, None], np.where(held, 0.0, -gradients), found)


class _Memory:
    """Changes of numbers and gradients of each descent."""

    def __init__(self, count: int):
        self._moved, self._turned, self._share = list[FloatArray](), list[FloatArray](), list[FloatArray]()
        self._scale = np.ones(count)

    def remember(self, which: BoolArray, moved: FloatArray, turned: FloatArray) -> None:
        """Changes of those descents, shapes [B, D]; the others keep what they knew before."""
        curvature = (moved * turned).sum(axis=1)
        length = np.linalg.norm(moved, axis=1) * np.linalg.norm(turned, axis=1)
        told = which & (curvature > LEAST_CURVATURE * length)
        self._moved.append(np.where(told[:, None], moved, 0.0))
        self._turned.append(np.where(told[:, None], turned, 0.0))
        self._share.append(np.where(told, 1.0 / np.where(told, curvature, 1.0), 0.0))
        self._scale = np.where(told, curvature / np.where(told, (turned**2).sum(axis=1), 1.0), self._scale)
        del self._moved[:-MEMORY], self._turned[:-MEMORY], self._share[:-MEMORY]

    def times(self, gradients: FloatArray) -> FloatArray:
        """The approximate inverse of each Hessian times its gradient (two loops; Nocedal 1980)."""
        found, shares = gradients.copy(), list[FloatArray]()
        for moved, turned, share in reversed(list(zip(self._moved, self._turned, self._share, strict=True))):
            shares.append(share * (moved * found).sum(axis=1))
            found -= shares[-1][:, None] * turned
        found *= self._scale[:, None]
        for moved, turned, share in zip(self._moved, self._turned, self._share, strict=True):
            found += (shares.pop() - share * (turned * found).sum(axis=1))[:, None] * moved
        return found
