"""What all lines of a print have in common: their section, what is printed where they cross, and thicker ends."""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from warp_caustics.prints.sections import EXPONENTS
from warp_caustics.types import FloatArray

COSINE_HALF = 0.5
"""t = 2 r / w at which a raised cosine is half as high as its crown."""
HALVINGS = 45
"""Of the range in which a height is looked for: to 3e-14."""
FADED = 1e-6
"""Of a crown: at most two nanometres."""


class Shape(NamedTuple):
    """What all lines of a print have in common: their section, what is printed where they cross, and thicker ends.

    The section is ((1 - p) cos(pi t / 2)^2 + p (1 - t^2))^g with t = 2 r / w: cosines and parabolas of any power, with
    the ellipse (p = 1, g = 0.5), and what lies between. Gaussians are within 0.005 % of their crown (root mean square,
    g = 600, and a width that is mostly tail), circular caps of 25, 55 and 70 degrees within 0.1, 0.6 and 0.8 %. A p
    above 1 would be nearer to caps (0.02, 0.2 and 0.9 %), and descents from a cosine to an ellipse would end there.
    Gaussians that meet the plate with a kink are 0.1 to 0.6 % off these: of them the section is
    (s(t) - f) / (1 - f), s as above, where that is above 0.
    """

    exponent: float = 1.0
    """g."""
    parabola: float = 0.0
    """p, from 0 to 1."""
    overlap: float = 1.0
    """q of :mod:`~warp_caustics.prints.overlap`: at 1 lines add up where they cross, at 0 the highest is printed."""
    thicker: float = 0.0
    """Share by which lines are wider and higher where the machine starts and stops [1]; by thicker exp(-(s / end)^2) at
    a way s from there, as :func:`~warp_caustics.prints.imperfections.thick_ends` prints them."""
    end_m: float = 1e-3
    """That length [m]."""
    cut: float = 0.0
    """f: share of the uncut crown at which the section meets the plate [1]."""
    is_cap: bool = False
    """Whether the section is the circular cap of a line's own width and height, which surface tension rounds; then g
    and p are none."""

    def with_section(self, other: "Shape") -> "Shape":
        """The same with the section of another one."""
        return self._replace(exponent=other.exponent, parabola=other.parabola, cut=other.cut, is_cap=other.is_cap)

    def clipped(self) -> "Shape":
        """Within what prints have."""
        within = (min(max(at, low), high) for at, low, high in zip(self, *SHAPE_LIMITS, strict=True))
        g, p, q, thicker, end_m, cut, _ = within
        return Shape(g, p, q, thicker, end_m, cut, self.is_cap)


SHAPE_LIMITS = (Shape(EXPONENTS[0], 0.0, 0.0, 0.0, 2e-4), Shape(600.0, 1.0, 1.0, 0.8, 4e-3, 0.4, is_cap=True))
"""Of each of its numbers: the least and the largest that prints have."""


def line_section(shape: Shape, t: FloatArray) -> FloatArray:
    """Height relative to the crown [1] at t = 2 r / w, any shape; 0 from the edge on: the oracle of the kernel.

    That of a cap depends on its line: see :class:`~warp_caustics.prints.sections.CrossSection`.
    """
    inside = np.clip(np.abs(t), 0.0, 1.0)
    base = (1 - shape.parabola) * np.cos(np.pi / 2 * inside) ** 2 + shape.parabola * (1 - inside**2)
    uncut = np.maximum(base, 0.0) ** shape.exponent
    height: FloatArray = np.maximum(uncut - shape.cut, 0.0) / (1 - shape.cut)
    return height


def _place_of(shape: Shape, uncut: float) -> float:
    """t = 2 r / w at which the section that is not cut has a height relative to its crown, between 0 and 1 [1]."""
    # (1 - p) cos(pi t / 2)^2 + p (1 - t^2) falls all the way from 1 to 0, so halves of the range close in on it.
    level, p, low, high = uncut ** (1 / shape.exponent), shape.parabola, 0.0, 1.0
    for _ in range(HALVINGS):
        t = (low + high) / 2
        is_above = (1 - p) * math.cos(math.pi / 2 * t) ** 2 + p * (1 - t * t) > level
        low, high = (t, high) if is_above else (low, t)
    return (low + high) / 2


@lru_cache(maxsize=64)
def half_height(shape: Shape) -> float:
    """t = 2 r / w at which the section is half as high as its crown [1]; of caps that of a flat one."""
    if shape.is_cap:
        return math.sqrt(0.5)
    return _place_of(shape, (1 + shape.cut) / 2)


@lru_cache(maxsize=64)
def section_edge(shape: Shape) -> float:
    """t = 2 r / w where the section is cut, or from which it is lower than any image shows [1]; 1 where it ends itself.

    1 - t^2 is at least as large as cos(pi t / 2)^2, so that a power of it is a bound.
    """
    if shape.is_cap:
        return 1.0
    if shape.cut > FADED:
        return _place_of(shape, shape.cut)
    if shape.exponent <= 1:
        return 1.0
    return min(1.0, math.sqrt(max(1 - FADED ** (1 / shape.exponent), 0.0)))
