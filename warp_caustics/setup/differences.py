"""Derivatives of a function of one number by differences at two steps, and how far the two disagree."""

from collections.abc import Callable
from typing import NamedTuple

import torch


class Difference(NamedTuple):
    """A derivative.

    Attributes:
        derivative: shape of the function's value.
        disagreement: norm of what the longer step finds less what the shorter one finds, over that of the derivative.
            Where the function is smooth about 3 times what is left of the error before it is extrapolated away; where
            it has kinks, what a difference there means.
    """

    derivative: torch.Tensor
    disagreement: float


def difference(
    function: Callable[[float], torch.Tensor], at: float, step: float, low: float, high: float
) -> Difference:
    """df/dx by Richardson's extrapolation over the steps s and s / 2.

    Central where the range allows it, (4 D(s/2) - D(s)) / 3 with an error of s^4 (Abramowitz and Stegun, 25.3.21);
    else from one side, D(s) = (-5 f(s) + 8 f(2 s) - 3 f(3 s)) / (2 s), extrapolated alike with an error of s^3. That is
    the derivative at x of the parabola through three points beside x: x itself, at the end of its range, may be a
    model of its own. The step is cut to a quarter of the range.

    Args:
        function: of x.
        at: x, within the range.
        step: s, in the unit of x.
        low: least x.
        high: largest x.
    """
    step = min(step, (high - low) / 4)
    room = min(at - low, high - at)
    # A step that is cut short too far drowns in rounding; one side then is better.
    if room >= step / 16:
        whole = min(step, room)

        def slope(s: float) -> torch.Tensor:
            return (function(at + s) - function(at - s)) / (2 * s)

    else:
        whole = step if high - at >= at - low else -step

        def slope(s: float) -> torch.Tensor:
            return (-5 * function(at + s) + 8 * function(at + 2 * s) - 3 * function(at + 3 * s)) / (2 * s)

    coarse, fine = slope(whole), slope(whole / 2)
    derivative = (4 * fine - coarse) / 3
    size = float(torch.linalg.vector_norm(derivative))
    apart = float(torch.linalg.vector_norm(coarse - fine))
    return Difference(derivative, apart / size if size > 0 else 0.0)
