"""How prints differ from one another: cross section, how lines merge, bow of the base. Drawn per relief.

No source gives the section of a printed glass line, so a network must not rely on one: families and exponents of
:func:`warp_caustics.prints.line.section_height`.
"""

from dataclasses import dataclass
from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from warp_caustics.prints.line import COSINE_EXPONENT, FAMILIES, Section
from warp_caustics.prints.sections import KINDS, RIGHT_ANGLE, CrossSection, Kind
from warp_caustics.strict import Strict
from warp_caustics.types import FloatArray

MAX_MERGING = 12.0
"""Largest p: beyond, heights of 1 um to the p-th power are lost in float32, and two equal lines are 6 % high."""

TRAIT_COLUMNS = ("section", "exponent", "reach", "merging", "bow_xx", "bow_xy", "bow_yy")
"""Columns of a relief's traits; the bow is b = bow_xx x^2 + bow_xy x y + bow_yy y^2 [1/m]."""

Share = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]
Exponent = Annotated[float, Field(ge=0.25, le=4, allow_inf_nan=False)]
Reach = Annotated[float, Field(ge=1, le=3, allow_inf_nan=False)]
Merging = Annotated[float, Field(ge=1, le=MAX_MERGING, allow_inf_nan=False)]


class PrintVariety(Strict):
    """How much prints differ. Each relief draws its traits; those left out stay as the pattern says."""

    section_share: Share = 0.6
    """Of the reliefs have another section than the pattern's: one of three families, with g drawn."""
    exponent: tuple[Exponent, Exponent] = (0.5, 1.6)
    """g."""
    reach: tuple[Reach, Reach] = (1.0, 2.0)
    """e: where the feet of a Gaussian line end, in halves of its width; the other sections end at 1."""
    merging_share: Share = 0.25
    """Of the reliefs have lines that merge, (sum of h^p)^(1/p), and are not added up."""
    merging: tuple[Merging, Merging] = (2.0, MAX_MERGING)
    """p, its logarithm uniform: 1 adds lines up, much takes the highest."""
    bow_share: Share = 1 / 3
    """Of the reliefs have a base that is bowed."""
    bow_m: Annotated[float, Field(ge=0, le=1e-3, allow_inf_nan=False)] = 30e-6
    """Largest sag between the plate's centre and the middle of a side [m], uniform in both directions."""

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        for name in ("exponent", "reach", "merging"):
            low, high = getattr(self, name)
            if low > high:
                raise ValueError(f"{name}: lower end {low:g} is above upper end {high:g}; swap them")
        return self


@dataclass(frozen=True)
class PrintTraits:
    """What one print is like.

    Attributes:
        section: family of the cross section.
        exponent: g.
        reach: e, where the section ends, in halves of the width.
        merging: p of lines on top of each other; 1 adds them up, infinity takes the highest.
        bow: coefficients (xx, xy, yy) of the base's bow [1/m].
        contact_angle_rad: theta of a cap [rad].
        wave: of the base, (a, k_x, k_y, phase): a sin(k_x x + k_y y + phase); [m, rad/m, rad/m, rad].
    """

    section: Kind = "cosine"
    exponent: float = 1.0
    reach: float = 1.0
    merging: float = 1.0
    bow: tuple[float, float, float] = (0.0, 0.0, 0.0)
    contact_angle_rad: float = RIGHT_ANGLE
    wave: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)

    @property
    def cross_section(self) -> CrossSection:
        """The section with its parameters."""
        return CrossSection(self.section, self.exponent, self.reach, self.contact_angle_rad)

    def row(self) -> tuple[float, ...]:
        """As the kernel of plain lines takes it, TRAIT_COLUMNS."""
        return (float(KINDS.index(self.section)), self.exponent, self.reach, self.merging, *self.bow)

    def path_row(self) -> tuple[float, ...]:
        """As the kernel of lines of any shape takes it, ``PATH_TRAIT_COLUMNS``."""
        number, _, *rest = self.row()
        return (number, self.cross_section.parameter, *rest, *self.wave)


def plain_traits(section: Section) -> PrintTraits:
    """Of prints that do not vary."""
    return PrintTraits(exponent=COSINE_EXPONENT[section])


def draw_traits(
    variety: PrintVariety, plain: PrintTraits, plate_size_m: tuple[float, float], rng: np.random.Generator
) -> PrintTraits:
    """Traits of one relief.

    Args:
        variety: what may differ.
        plain: traits of a print that does not.
        plate_size_m: extent along x and y [m].
        rng: source of randomness; as many numbers are taken whatever comes out.
    """
    has_section, has_merging, has_bow = rng.random(3) < (
        variety.section_share,
        variety.merging_share,
        variety.bow_share,
    )
    family, exponent = int(rng.integers(len(FAMILIES))), float(rng.uniform(*variety.exponent))
    reach = float(rng.uniform(*variety.reach))
    merging = float(np.exp(rng.uniform(*np.log(variety.merging))))
    sag, across, angle = rng.uniform((-variety.bow_m, -1.0, 0.0), (variety.bow_m, 1.0, np.pi))
    bow = (0.0, 0.0, 0.0)
    if has_bow:
        bow = bow_of(sag, across, angle, plate_size_m)
    return PrintTraits(
        FAMILIES[family] if has_section else plain.section,
        exponent if has_section else plain.exponent,
        reach if has_section and FAMILIES[family] == "gaussian" else plain.reach,
        merging if has_merging else plain.merging,
        bow,
    )


def bow_of(
    sag_m: float, across: float, angle_rad: float, plate_size_m: tuple[float, float]
) -> tuple[float, float, float]:
    """Bow of a base (``PrintTraits.bow``) [1/m]: a bowl, a saddle or a trough.

    Args:
        sag_m: between the plate's centre and the middle of its longer side [m].
        across: part of it across, from -1 to 1.
        angle_rad: direction of the sag, from the x axis [rad].
        plate_size_m: extent along x and y [m].
    """
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    scale = 4 * sag_m / max(plate_size_m) ** 2
    bow = (scale * (c**2 + across * s**2), scale * 2 * c * s * (1 - across), scale * (s**2 + across * c**2))
    return (float(bow[0]), float(bow[1]), float(bow[2]))


def merged(heights: FloatArray, merging: float) -> FloatArray:
    """Lines on top of each other: (sum of h^p)^(1/p) over the first axis; p = 1 adds them up, infinite: highest [m]."""
    if merging == 1.0:
        return np.asarray(heights.sum(axis=0))
    if np.isinf(merging):
        return np.asarray(heights.max(axis=0))
    highest = np.maximum(heights.max(axis=0), 1e-30)
    return np.asarray(highest * ((heights / highest) ** merging).sum(axis=0) ** (1 / merging))
