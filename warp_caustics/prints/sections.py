"""Cross sections of prints as made: the families of lines, and the cap that surface tension rounds.

t = 2 r / w is 0 on the centre line and 1 at the edge, heights are relative to the crown H. Three families stand in
:mod:`warp_caustics.prints.line`; the fourth is the **circular cap** of contact angle theta, c = cos(theta),
s = sin(theta), the shape of a liquid thread that gravity does not flatten:

    height / H = (sqrt(1 - s^2 t^2) - c) / (1 - c),   H / w = tan(theta / 2) / 2 = (1 - c) / (2 s).

A cap of more than 90 degrees overhangs its foot: it has two heights at one place and is no height field. No source
gives the section of a printed glass line; these are shapes to be robust against, not measurements.
"""

import math
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from warp_caustics.errors import InputError
from warp_caustics.prints.line import section_height
from warp_caustics.types import FloatArray

Kind = Literal["cosine", "parabola", "gaussian", "cap"]
KINDS: tuple[Kind, ...] = get_args(Kind)
"""In the order of their numbers in the kernels; the first three are :data:`warp_caustics.prints.line.FAMILIES`."""

RIGHT_ANGLE = math.pi / 2
LEAST_CONTACT_ANGLE_RAD = math.radians(0.5)
"""Below, a cap is a parabola to 1e-5 of its crown, and flatter than what any print is."""
EXPONENTS = (0.25, 4.0)
REACHES = (1.0, 3.0)


@dataclass(frozen=True)
class CrossSection:
    """Shape of a line across.

    Attributes:
        kind: family.
        exponent: g of a family with a power.
        reach: e, where the section ends, in halves of the width; above 1 for a Gaussian only.
        contact_angle_rad: theta of a cap [rad], at most pi / 2.
    """

    kind: Kind = "cosine"
    exponent: float = 1.0
    reach: float = 1.0
    contact_angle_rad: float = RIGHT_ANGLE

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise InputError(f"section {self.kind!r} is not known; use one of {', '.join(KINDS)}")
        if not EXPONENTS[0] <= self.exponent <= EXPONENTS[1]:
            raise InputError(f"exponent {self.exponent:g} is not from {EXPONENTS[0]:g} to {EXPONENTS[1]:g}; give 1")
        if not REACHES[0] <= self.reach <= REACHES[1]:
            raise InputError(f"reach {self.reach:g} is not from {REACHES[0]:g} to {REACHES[1]:g}; give 1")
        if self.reach != 1.0 and self.kind != "gaussian":
            raise InputError(f"reach {self.reach:g} of a {self.kind}, which ends at 1; leave it out")
        if self.kind == "cap":
            check_contact_angle(self.contact_angle_rad)

    @property
    def parameter(self) -> float:
        """What the kernels take: g, or cos(theta) of a cap."""
        if self.kind != "cap":
            return self.exponent
        return 0.0 if self.contact_angle_rad == RIGHT_ANGLE else math.cos(self.contact_angle_rad)

    def relative_height(self, t: FloatArray) -> FloatArray:
        """Height relative to the crown [1] at t = 2 r / w, any shape; 0 from the edge on."""
        if self.kind != "cap":
            return section_height(t, self.kind, self.exponent, self.reach)
        c = self.parameter
        # The formula above times (sqrt(..) + c) / (sqrt(..) + c): no difference of equal numbers at small angles.
        inside = np.clip(1 - np.square(t), 0.0, None)
        root = np.sqrt(np.clip(1 - (1 - c**2) * np.square(t), 0.0, None))
        return np.where(t < 1.0, (1 + c) * inside / np.maximum(root + c, 1e-300), 0.0)

    def area_factor(self) -> float:
        """Area of the section over w H [1], from the Beta function, the error function, or the circle."""
        g = self.exponent
        if self.kind == "cosine":
            return math.gamma(g + 0.5) / (math.sqrt(math.pi) * math.gamma(g + 1))
        if self.kind == "parabola":
            return math.sqrt(math.pi) * math.gamma(g + 1) / (2 * math.gamma(g + 1.5))
        if self.kind == "gaussian":
            k = 4 * math.log(2) * g
            edge = math.exp(-k * self.reach**2)
            whole = math.sqrt(math.pi / k) / 2 * math.erf(math.sqrt(k) * self.reach)
            return (whole - self.reach * edge) / (1 - edge)
        theta, c, s = self.contact_angle_rad, self.parameter, math.sin(self.contact_angle_rad)
        return (theta - s * c) / (2 * s * (1 - c))

    def area_m2(self, width_m: float, height_m: float) -> float:
        """Cross-section area [m^2] of a line of a full width and a crown height [m]."""
        return self.area_factor() * width_m * height_m

    def foot_angle_rad(self, width_m: float, height_m: float) -> float:
        """Angle at which a line meets the plate [rad]: arctan of its slope at the edge; pi / 2 where it is upright."""
        return math.atan(2 * height_m / width_m * self._foot_slope())

    def _foot_slope(self) -> float:
        """-d(height / H)/dt at the edge, from inside [1]."""
        if self.kind == "gaussian":
            k = 4 * math.log(2) * self.exponent
            edge = math.exp(-k * self.reach**2)
            return 2 * k * self.reach * edge / (1 - edge)
        if self.kind == "cap":
            return math.inf if self.parameter == 0.0 else (1 + self.parameter) / self.parameter
        straight, slope = (0.5, math.pi / 2) if self.kind == "cosine" else (1.0, 2.0)
        if self.exponent == straight:
            return slope
        return 0.0 if self.exponent > straight else math.inf


SectionName = Literal["cosine", "quarter", "cap", "ellipse", "parabola", "gaussian"]
SECTION_NAMES: tuple[SectionName, ...] = get_args(SectionName)

_NAMED: dict[SectionName, tuple[Kind, float]] = {
    "cosine": ("cosine", 1.0),
    "quarter": ("cosine", 0.5),
    "cap": ("cap", 1.0),
    "ellipse": ("parabola", 0.5),
    "parabola": ("parabola", 1.0),
    "gaussian": ("gaussian", 1.0),
}


def named_section(
    name: str, *, exponent: float | None = None, reach: float = 1.0, contact_angle_rad: float | None = None
) -> CrossSection:
    """A section by its name.

    Args:
        name: one of ``SECTION_NAMES``.
        exponent: g in place of the name's own: of ``cosine`` the family cos^(2g), of ``parabola`` (1 - t^2)^g.
        reach: e of a Gaussian.
        contact_angle_rad: theta of a cap [rad]; a cap needs it.

    Raises:
        InputError: no such section, or a value that it does not have.
    """
    if name not in SECTION_NAMES:
        raise InputError(f"section {name!r} is not known; use one of {', '.join(SECTION_NAMES)}")
    kind, power = _NAMED[name]
    if name == "cap" and contact_angle_rad is None:
        raise InputError("section 'cap' needs a contact angle; give one above 0 and up to 90 degrees")
    if name in ("cap", "quarter", "ellipse") and exponent is not None:
        family = {"quarter": "cosine", "ellipse": "parabola"}.get(name, "cosine")
        raise InputError(f"section {name!r} takes no exponent, got {exponent:g}; leave it out, or use {family!r}")
    angle = RIGHT_ANGLE if contact_angle_rad is None else contact_angle_rad
    return CrossSection(kind, power if exponent is None else exponent, reach, angle)


def check_contact_angle(angle_rad: float) -> None:
    """Refuse a contact angle whose cap is no height field.

    Raises:
        InputError: above 90 degrees, or not above ``LEAST_CONTACT_ANGLE_RAD``.
    """
    if not LEAST_CONTACT_ANGLE_RAD <= angle_rad <= RIGHT_ANGLE:
        degrees = math.degrees(angle_rad)
        if angle_rad > RIGHT_ANGLE:
            raise InputError(
                f"contact angle {degrees:.4g} degrees is above 90: the line overhangs its foot and is no height field; "
                "give at most 90, or a wider line of the same glass"
            )
        raise InputError(f"contact angle {degrees:.4g} degrees; give {math.degrees(LEAST_CONTACT_ANGLE_RAD):g} to 90")


def cap_proportion(contact_angle_rad: float) -> float:
    """H / w of a circular cap [1]: tan(theta / 2) / 2."""
    return math.tan(contact_angle_rad / 2) / 2


def cap_contact_angle_rad(width_m: float, height_m: float) -> float:
    """theta of the circular cap of a width and height [rad], up to pi: 2 arctan(2 H / w)."""
    return 2 * math.atan(2 * height_m / width_m)
