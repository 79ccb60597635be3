"""How far to go in one number of a bench, by what one round says and what the last one said.

Heights that were found on a wrong bench keep a share of what the image says of it to themselves, half of it near the
right one and nine tenths far away: a step is too short, and does not get shorter on the way until late.
"""

import math

FURTHER = 1.5
"""By which first steps are lengthened: heights that are wrong take half to three quarters of what the image says of a
bench to themselves, and the next round takes back what was too much."""
FURTHEST = 4.0
"""By which later ones are at most: far from the right bench heights take nine tenths, and steps do not get shorter."""


def lengthened(value: float, move: float, sigma: float, was: tuple[float, float] | None) -> float:
    """How far to go where one step says ``move``: to where steps end by the secant through this one and the last.

    Args:
        value: of a number of the bench.
        move: of the step from there.
        sigma: its standard deviation; what is within tells no secant.
        was: value and move of the round before; None in the first.
    """
    if was is None or abs(move) < sigma or abs(value - was[0]) < sigma:
        return FURTHER * move
    slope = (move - was[1]) / (value - was[0])
    longest = FURTHEST * abs(move)
    return math.copysign(min(abs(move / slope), longest) if slope < 0 else longest, move)
