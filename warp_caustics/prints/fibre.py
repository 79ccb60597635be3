"""From a fibre to the line that it melts into: the glass is conserved.

A pass of a fibre of diameter d lays down the cross-section area pi d^2 / 4; passes over the same line add up. What
the section is and one of contact angle, width or height say how that area spreads. For a circular cap, with
f(theta) = theta - sin(theta) cos(theta):

    A = R^2 f(theta),  w = 2 R sin(theta),  H = R (1 - cos(theta)).

At 90 degrees w = sqrt(8 A / pi): sqrt(2) d for one pass. What is narrower overhangs.
"""

import math

from warp_caustics.errors import InputError
from warp_caustics.prints.sections import (
    RIGHT_ANGLE,
    CrossSection,
    cap_proportion,
    check_contact_angle,
    named_section,
)

MOST_PASSES = 1000


def fibre_area_m2(diameter_m: float, passes: int = 1) -> float:
    """Cross-section area of passes of a fibre on top of each other [m^2].

    Args:
        diameter_m: d [m].
        passes: how many.

    Raises:
        InputError: a diameter or number of passes that is not above 0.
    """
    if not (math.isfinite(diameter_m) and diameter_m > 0):
        raise InputError(f"fibre diameter {diameter_m:g} m is not above 0; give for example 0.4e-3")
    if not 1 <= passes <= MOST_PASSES:
        raise InputError(f"{passes} passes; give 1 to {MOST_PASSES}")
    return passes * math.pi / 4 * diameter_m**2


def cap_of_area(area_m2: float, contact_angle_rad: float) -> tuple[float, float]:
    """Width and height [m] of the circular cap of an area and a contact angle.

    Raises:
        InputError: an angle that overhangs.
    """
    check_contact_angle(contact_angle_rad)
    return proportioned(named_section("cap", contact_angle_rad=contact_angle_rad), area_m2, contact_angle_rad)


def proportioned(section: CrossSection, area_m2: float, contact_angle_rad: float) -> tuple[float, float]:
    """Width and height [m] of any section of an area, H / w as of the circular cap of a contact angle [rad]."""
    proportion = cap_proportion(contact_angle_rad)
    width = math.sqrt(area_m2 / (section.area_factor() * proportion))
    return width, proportion * width


def height_of_area(section: CrossSection, area_m2: float, width_m: float) -> float:
    """Crown height [m] of a line of a section, an area and a full width."""
    return area_m2 / (section.area_factor() * width_m)


def least_cap_width_m(area_m2: float) -> float:
    """Width of the cap of 90 degrees [m], the narrowest that is a height field: sqrt(8 A / pi)."""
    return math.sqrt(8 * area_m2 / math.pi)


def cap_angle_of_area(area_m2: float, width_m: float) -> float:
    """Contact angle of the circular cap of an area and a width [rad], between 0 and pi.

    A / w^2 = f(theta) / (4 sin(theta)^2) grows with theta, and is solved by bisection.
    """
    wanted = area_m2 / width_m**2
    low, high = 0.0, math.pi
    for _ in range(200):
        theta = (low + high) / 2
        if theta in (low, high):
            break
        is_above = theta - math.sin(theta) * math.cos(theta) > 4 * wanted * math.sin(theta) ** 2
        low, high = (low, theta) if is_above else (theta, high)
    return (low + high) / 2


def cap_of_width(area_m2: float, width_m: float) -> tuple[float, float]:
    """Contact angle [rad] and height [m] of the circular cap of an area and a width.

    Raises:
        InputError: the fibre does not fit into the width: its contact angle, and the width that it needs.
    """
    angle, least = cap_angle_of_area(area_m2, width_m), least_cap_width_m(area_m2)
    if angle > RIGHT_ANGLE * (1 + 1e-9):
        raise InputError(
            f"{area_m2 * 1e6:.4g} mm^2 of glass on a foot of {width_m * 1e3:.4g} mm has a contact angle of "
            f"{math.degrees(angle):.4g} degrees: it overhangs and is no height field; make it at least "
            f"{math.ceil(least * 1e6) / 1e3:.4g} mm wide"
        )
    angle = min(angle, RIGHT_ANGLE)
    return angle, cap_proportion(angle) * width_m
