"""Intervals (lowest, highest) from which configurations draw, checked."""

import math
from typing import Annotated

from pydantic import AfterValidator

from warp_caustics.prints.line import MAX_LINES
from warp_caustics.prints.sections import LEAST_CONTACT_ANGLE_RAD, RIGHT_ANGLE
from warp_caustics.strict import Finite

MAX_LENGTH_M = 1.0
MOST_CHANGE = 0.9
"""A line that is thinner than a tenth of itself somewhere is no line."""


def check_order(value: tuple[float, float]) -> tuple[float, float]:
    """The interval; ValueError if it is turned round."""
    low, high = value
    if low > high:
        raise ValueError(f"lower end {low:g} is above upper end {high:g}; swap them, write [{high:g}, {low:g}]")
    return value


def _check_interval(value: tuple[float, float]) -> tuple[float, float]:
    low, high = check_order(value)
    if max(abs(low), abs(high)) > MAX_LENGTH_M:
        raise ValueError(f"({low:g}, {high:g}) m reaches beyond {MAX_LENGTH_M:g} m; give metres")
    return value


def _check_positive(value: tuple[float, float]) -> tuple[float, float]:
    if value[0] <= 0:
        raise ValueError(f"lower end {value[0]:g} m is not above 0; a printed line has a width and a height")
    return value


def check_amount(value: tuple[float, float]) -> tuple[float, float]:
    """The interval; ValueError if it begins below 0."""
    if value[0] < 0:
        raise ValueError(f"lower end {value[0]:g} is below 0; give 0 for none")
    return value


def _check_share(value: tuple[float, float]) -> tuple[float, float]:
    low, high = value
    if not 0 <= low <= high <= MOST_CHANGE:
        raise ValueError(
            f"({low:g}, {high:g}) of the line; give 0 <= lowest <= highest <= {MOST_CHANGE:g}, for example (0, 0.04)"
        )
    return value


def _check_angles(value: tuple[float, float]) -> tuple[float, float]:
    low, high = value
    if not -7 <= low <= high <= 7:
        raise ValueError(f"({low:g}, {high:g}) rad is no interval between -7 and 7; give radians, the lower end first")
    return value


def _check_contact_angles(value: tuple[float, float]) -> tuple[float, float]:
    low, high = value
    if low > high:
        raise ValueError(f"lower end {low:g} is above upper end {high:g}; swap them")
    if high > RIGHT_ANGLE:
        raise ValueError(
            f"contact angle {high:g} rad, {math.degrees(high):.4g} degrees, is above 90: such lines overhang and are "
            f"no height fields; give at most {math.floor(RIGHT_ANGLE * 1e4) / 1e4}"
        )
    if low < LEAST_CONTACT_ANGLE_RAD:
        raise ValueError(f"contact angle {low:g} rad; give at least {LEAST_CONTACT_ANGLE_RAD:.2g}")
    return value


def _check_count(value: tuple[int, int]) -> tuple[int, int]:
    low, high = value
    if not 0 <= low <= high <= MAX_LINES:
        raise ValueError(f"({low}, {high}) lines; give 0 <= lowest <= highest <= {MAX_LINES}")
    return value


def _check_some(value: tuple[int, int]) -> tuple[int, int]:
    if value[0] < 1:
        raise ValueError(f"({value[0]}, {value[1]}); give at least 1")
    return value


Interval = Annotated[tuple[Finite, Finite], AfterValidator(_check_interval)]
PositiveInterval = Annotated[Interval, AfterValidator(_check_positive)]
AmountInterval = Annotated[Interval, AfterValidator(check_amount)]
ShareInterval = Annotated[tuple[Finite, Finite], AfterValidator(_check_share)]
AngleInterval = Annotated[tuple[Finite, Finite], AfterValidator(_check_angles)]
ContactAngleInterval = Annotated[tuple[Finite, Finite], AfterValidator(_check_contact_angles)]
CountInterval = Annotated[tuple[int, int], AfterValidator(_check_count)]
SomeInterval = Annotated[CountInterval, AfterValidator(_check_some)]
