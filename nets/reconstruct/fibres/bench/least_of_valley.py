"""The least of what is left of an image along one number: downhill by steps that grow, then a parabola."""

from collections.abc import Callable
from typing import Protocol, TypeVar

MOST_STEPS = 5
"""Each twice as long as the one before: 31 first steps in all."""


class OnWay(Protocol):
    """What is left of an image, ``loss``, where (n - 1) D is larger by a ``share``."""

    @property
    def share(self) -> float: ...

    @property
    def loss(self) -> float: ...


def vertex(left: OnWay, middle: OnWay, right: OnWay) -> tuple[float, float]:
    """Share at which the parabola through three trials is least, between the outer ones; and its second derivative."""
    to_left, to_right = middle.share - left.share, right.share - middle.share
    fall, rise = (middle.loss - left.loss) / to_left, (right.loss - middle.loss) / to_right
    curvature = 2 * (rise - fall) / (to_left + to_right)
    if curvature <= 0:
        return middle.share, 0.0
    slope = (fall * to_right + rise * to_left) / (to_left + to_right)
    return min(max(middle.share - slope / curvature, left.share), right.share), curvature


T = TypeVar("T", bound=OnWay)


def bracketed(trial: Callable[[T, float], T], start: T, best: T) -> tuple[T, T, T] | None:
    """Three trials by share, the middle one the least; None where it falls as far as steps go.

    Args:
        trial: made from the one nearby, at a share.
        start: where the search began.
        best: a step away, which leaves less.
    """
    before, step = start, best.share - start.share
    for _ in range(MOST_STEPS - 1):
        step *= 2
        after = trial(best, best.share + step)
        if after.loss >= best.loss:
            first, last = sorted((before, after), key=lambda each: each.share)
            return first, best, last
        before, best = best, after
    return None
