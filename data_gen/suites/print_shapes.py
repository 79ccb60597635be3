"""Suite ``prints``: shapes, sections, overlaps and flaws of prints, one at a time; the bench is as it is told."""

import math
from dataclasses import dataclass
from typing import Any

from data_gen.config import (
    CurvesConfig,
    DropsConfig,
    MeandersConfig,
    PatternConfig,
    PolylinesConfig,
    ReliefConfig,
    RingsConfig,
    TextConfig,
)
from data_gen.making import Making
from data_gen.suites.case import Case, Plate, bench_plates

SEED = 20_261_202
PLATES = 5
FIBRE_M = 4e-4
"""Diameter of the fibre that the supplement prints with [m]."""
CAP_ANGLES_RAD = (math.radians(25), math.radians(70))
"""Contact angles of fused fibres: below, they are hardly lines; above, they nearly stand."""


@dataclass(frozen=True)
class Shape:
    """What is printed.

    Attributes:
        title: for people.
        reliefs: the pattern, with how it is made.
    """

    title: str
    reliefs: PatternConfig


def made(**making: Any) -> ReliefConfig:
    """Straight lines of Tab. 3, made so."""
    return ReliefConfig(making=Making(**making))


def fibre_caps(passes: int) -> Making:
    """Fibres fused to circular caps of their glass, up to so many passes on top of each other."""
    return Making(
        sections=("cap",), contact_angle_rad=CAP_ANGLES_RAD, fibre_diameter_m=(FIBRE_M, FIBRE_M), passes=(1, passes)
    )


FIBRE_LINES = {"line_count": (8, 30)}
"""One fibre is thin: as many lines as Tab. 3 allows, or the plate is all but empty."""

SHAPES: dict[str, Shape] = {
    "lines": Shape("straight lines of Tab. 3, cos^2", ReliefConfig()),
    "polylines": Shape("lines with corners", PolylinesConfig()),
    "meanders": Shape("meanders", MeandersConfig()),
    "curves": Shape("Bezier curves", CurvesConfig()),
    "rings": Shape("rings", RingsConfig()),
    "drops": Shape("round drops", DropsConfig()),
    "text": Shape("text", TextConfig()),
    "section-quarter": Shape("section: quarter cosine", made(sections=("quarter",))),
    "section-ellipse": Shape("section: ellipse", made(sections=("ellipse",))),
    "section-parabola": Shape("section: parabola", made(sections=("parabola",))),
    "section-gaussian": Shape("section: Gaussian with feet", made(sections=("gaussian",), reach=(1.5, 1.5))),
    "section-cap": Shape(
        "section: circular cap, 25 to 70 degrees", made(sections=("cap",), contact_angle_rad=CAP_ANGLES_RAD)
    ),
    "section-cos-power": Shape("section: cos^(2g), g 0.5 to 1.6", made(sections=("cosine",), exponent=(0.5, 1.6))),
    "section-parabola-power": Shape(
        "section: (1 - 4u^2)^g, g 0.5 to 1.6", made(sections=("parabola",), exponent=(0.5, 1.6))
    ),
    "fibre-caps": Shape("0.4 mm fibres fused to caps, one pass", ReliefConfig(making=fibre_caps(1), **FIBRE_LINES)),
    "fibre-passes": Shape(
        "0.4 mm fibres fused to caps, 1 to 6 passes", ReliefConfig(making=fibre_caps(6), **FIBRE_LINES)
    ),
    "merged-max": Shape("crossing lines: the highest", made(sections=("cosine",), overlaps=("max",))),
    "merged-smooth": Shape("crossing lines merge smoothly", made(sections=("cosine",), overlaps=("merge",))),
    "waviness": Shape(
        "width and height vary by 4 %, the way by 50 um",
        made(sections=("cosine",), waviness=(0.04, 0.04), sideways_m=(5e-5, 5e-5)),
    ),
    "thick-ends": Shape("ends 30 % thicker", made(sections=("cosine",), end_thickness=(0.3, 0.3))),
    "bow": Shape("base bowed by up to 30 um", made(sections=("cosine",), bow_m=30e-6)),
    "base-wave": Shape("base with waves of up to 5 um", made(sections=("cosine",), base_wave_m=5e-6)),
}
"""By row."""


def cases(count: int, seed: int | None = None) -> list[Case]:
    """The cases, row by row, with the first ``count`` plates of each; of another seed than the suite's if given."""
    found = []
    for row, shape in SHAPES.items():
        config = bench_plates(SEED if seed is None else seed, PLATES, shape.reliefs)
        found += [
            Case("prints", row, shape.title, Plate(config, number), config.scene, config.scene)
            for number in range(count)
        ]
    return found
