"""Distributions of printed reliefs: Tab. 3 of the supplement, and other print patterns.

Everything is in metres; (0, 0) is the centre of the plate. Each pair is an
interval (lowest, highest) from which values are drawn uniformly.
"""

from typing import Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, Discriminator, Field, Tag, model_validator

from data_gen.intervals import (
    MAX_LENGTH_M,
    AngleInterval,
    CountInterval,
    Interval,
    PositiveInterval,
    SomeInterval,
)
from data_gen.making import Making
from data_gen.variety import PrintVariety
from warp_caustics.prints.font import GLYPHS, MOST_CHARACTERS
from warp_caustics.prints.line import MAX_SUPERSAMPLING, Section
from warp_caustics.strict import Finite, Strict

MAX_PICTURE_CELLS = 1_000_000
MAX_MERGING_SUPERSAMPLING = 8
"""With lines that merge each thread of the printing kernel keeps supersampling^2 sums."""


def _check_picture(rows: tuple[str, ...]) -> tuple[str, ...]:
    if len({len(row) for row in rows}) != 1 or not rows[0]:
        raise ValueError("picture rows differ in length or are empty; give rows of equal length")
    if set("".join(rows)) - set("#."):
        raise ValueError("picture rows hold other characters than # (fibre) and . (bare plate)")
    if len(rows) * len(rows[0]) > MAX_PICTURE_CELLS:
        raise ValueError(f"picture of {len(rows)} x {len(rows[0])} is too large; use {MAX_PICTURE_CELLS} cells at most")
    return rows


def _check_text(text: str) -> str:
    strange = sorted(set(text) - set(GLYPHS) - {"\n"})
    if strange:
        raise ValueError(f"text holds {strange[0]!r}, which the stroke font does not have; use capitals and digits")
    if len(text) > MOST_CHARACTERS or (text and not text.strip()):
        raise ValueError(f"text of {len(text.strip())} characters; give 1 to {MOST_CHARACTERS}, or none to draw them")
    return text


def _check_control(value: tuple[int, int]) -> tuple[int, int]:
    if not 2 <= value[0] <= value[1] <= 16:
        raise ValueError(f"({value[0]}, {value[1]}) control points; give 2 to 16")
    return value


class Perturbation(Strict):
    """Offsets added to a line for the updater's data set (last column of Tab. 3)."""

    line_start_m: Interval = (-2.5e-3, 2.5e-3)
    """Offset of the start, along x and along y [m]; a ring's centre."""
    line_end_m: Interval = (-2.5e-3, 2.5e-3)
    """Offset of the end, along x and along y [m]; a ring's radius."""
    line_width_m: Interval = (-1e-3, 1e-3)
    """Offset of the width [m]."""
    line_height_m: Interval = (-1e-3, 1e-3)
    """Offset of the height [m]."""


class PrintedPattern(Strict):
    """What all patterns of printed strokes share; unknown fields are refused."""

    line_width_m: PositiveInterval = (1e-4, 4e-3)
    """Full width w [m]."""
    line_height_m: PositiveInterval = (1e-4, 2e-3)
    """Height H of the centre line [m]."""
    perturbation: Perturbation = Perturbation()
    smallest_width_m: Annotated[Finite, Field(gt=0, le=MAX_LENGTH_M)] = 1e-4
    """A perturbed width below is raised to it [m]; a perturbed height below 0 becomes 0, a missing fibre.

    Tab. 3's offsets make 15 % of the lines non-positive in width or height and the paper does not say what
    becomes of them."""
    profile: Section = "cosine"
    """Cross section: cosine is H/2 (1 + cos(2 pi r / w)), quarter H cos(pi r / w), r from the centre line."""
    supersampling: Annotated[int, Field(ge=1, le=MAX_SUPERSAMPLING)] = 4
    """A height sample is the mean of supersampling^2 points of its cell; 7.5 % of the lines are narrower."""
    variety: PrintVariety | None = None
    """How prints differ from one another in section, merging and bow; None for prints that are all as above."""
    making: Making | None = None
    """Prints as a machine makes them: fibres, caps by contact angle, passes, waves, thick ends; None for ideal ones."""

    is_along_points: ClassVar[bool] = False
    """Whether lines have corners or curves, and so more than one row each."""

    @property
    def is_plain(self) -> bool:
        """Whether prints are straight lines and rings without any making."""
        return self.making is None and not self.is_along_points

    @property
    def has_chains(self) -> bool:
        """Whether the printing kernel must know which pieces are one line, or keep lines apart."""
        return self.is_along_points or (self.making is not None and self.making.has_chains)

    @model_validator(mode="after")
    def _merging_fits(self) -> "PrintedPattern":
        if self.variety is not None and self.making is not None:
            raise ValueError("variety and making both draw sections, merging and bow; set variety or making to null")
        if self.variety is not None and self.variety.merging_share and self.supersampling > MAX_MERGING_SUPERSAMPLING:
            raise ValueError(
                f"supersampling {self.supersampling} with lines that merge; use {MAX_MERGING_SUPERSAMPLING} at most, "
                "or variety.merging_share 0"
            )
        if self.has_chains and self.supersampling > MAX_MERGING_SUPERSAMPLING:
            raise ValueError(
                f"supersampling {self.supersampling} with lines of several pieces, or that merge; use "
                f"{MAX_MERGING_SUPERSAMPLING} at most"
            )
        return self

    @model_validator(mode="after")
    def _perturbed_width(self) -> "PrintedPattern":
        if self.smallest_width_m > self.line_width_m[1]:
            raise ValueError(
                f"smallest_width_m {self.smallest_width_m:g} exceeds the widest line {self.line_width_m[1]:g}; lower it"
            )
        return self


class ReliefConfig(PrintedPattern):
    """Straight lines anywhere: parameter ranges of Tab. 3, validated and immutable."""

    pattern: Literal["lines"] = "lines"
    """Lines anywhere."""
    line_count: CountInterval = (2, 30)
    """Number of lines, both ends included."""
    line_start_m: Interval = (-0.025, 0.025)
    """Where a line starts, along x and along y [m]."""
    line_end_m: Interval = (-0.025, 0.025)
    """Where a line ends, along x and along y [m]."""


class RasterConfig(PrintedPattern):
    """Parallel fibres side by side, as infill is printed; all of one width and height."""

    pattern: Literal["raster"] = "raster"
    """Parallel fibres."""
    line_count: CountInterval = (2, 12)
    """Number of fibres."""
    spacing_m: PositiveInterval = (1e-3, 4e-3)
    """Distance of neighbouring centre lines [m]."""
    angle_rad: AngleInterval = (0.0, 3.141592653589793)
    """Direction of the fibres, from the x axis [rad]."""
    length_m: PositiveInterval = (0.01, 0.045)
    """Length of the fibres [m]."""
    centre_m: Interval = (-0.005, 0.005)
    """Centre of the patch, along x and along y [m]."""


class RingsConfig(PrintedPattern):
    """Circles."""

    pattern: Literal["rings"] = "rings"
    """Circles."""
    line_count: CountInterval = (1, 8)
    """Number of rings."""
    centre_m: Interval = (-0.015, 0.015)
    """Centre of a ring, along x and along y [m]."""
    radius_m: PositiveInterval = (1e-3, 0.02)
    """Radius of a ring's centre line [m]."""


class PictureConfig(PrintedPattern):
    """A black and white picture, for example text, printed row by row as horizontal fibres."""

    pattern: Literal["picture"] = "picture"
    """A black and white picture."""
    rows: Annotated[tuple[str, ...], Field(min_length=1), AfterValidator(_check_picture)] = ("#",)
    """The picture, the topmost row (largest y) first: # is fibre, . is bare plate. See ``patterns.picture_rows``."""
    size_m: PositiveInterval = (0.03, 0.045)
    """Extent of the picture's longer side [m]."""
    centre_m: Interval = (-0.002, 0.002)
    """Centre of the picture, along x and along y [m]."""
    line_width_m: PositiveInterval = (5e-4, 1e-3)
    """Full width w [m]."""


class PolylinesConfig(PrintedPattern):
    """Lines with corners."""

    is_along_points: ClassVar[bool] = True
    pattern: Literal["polylines"] = "polylines"
    """Lines with corners."""
    line_count: CountInterval = (1, 6)
    """Number of lines."""
    start_m: Interval = (-0.02, 0.02)
    """Where a line starts, along x and along y [m]."""
    pieces: SomeInterval = (2, 8)
    """Straight pieces of a line."""
    piece_m: PositiveInterval = (3e-3, 0.015)
    """Length of a piece [m]."""
    turn_rad: AngleInterval = (-2.0, 2.0)
    """Change of direction at a corner, to the left if positive [rad]."""
    line_width_m: PositiveInterval = (3e-4, 3e-3)
    """Full width w [m]."""
    line_height_m: PositiveInterval = (1e-4, 1e-3)
    """Height H of the centre line [m]."""


class CurvesConfig(PrintedPattern):
    """Bezier curves."""

    is_along_points: ClassVar[bool] = True
    pattern: Literal["curves"] = "curves"
    """Bezier curves."""
    line_count: CountInterval = (1, 6)
    """Number of curves."""
    control_count: Annotated[SomeInterval, AfterValidator(_check_control)] = (3, 5)
    """Control points of a curve."""
    control_m: Interval = (-0.024, 0.024)
    """Where control points lie, along x and along y [m]."""
    line_width_m: PositiveInterval = (3e-4, 3e-3)
    """Full width w [m]."""
    line_height_m: PositiveInterval = (1e-4, 1e-3)
    """Height H of the centre line [m]."""


class MeandersConfig(PrintedPattern):
    """Lines laid to and fro, as a machine fills an area without stopping."""

    is_along_points: ClassVar[bool] = True
    pattern: Literal["meanders"] = "meanders"
    """Lines laid to and fro."""
    line_count: CountInterval = (1, 3)
    """Number of meanders."""
    rows: SomeInterval = (2, 8)
    """Straight rows of a meander."""
    length_m: PositiveInterval = (5e-3, 0.025)
    """Length of the straight part of a row [m]."""
    spacing_m: PositiveInterval = (1e-3, 4e-3)
    """Distance of neighbouring rows [m], the diameter of the turns."""
    angle_rad: AngleInterval = (0.0, 3.141592653589793)
    """Direction of the rows, from the x axis [rad]."""
    centre_m: Interval = (-0.01, 0.01)
    """Centre of a meander, along x and along y [m]."""
    line_width_m: PositiveInterval = (3e-4, 2e-3)
    """Full width w [m]."""
    line_height_m: PositiveInterval = (1e-4, 8e-4)
    """Height H of the centre line [m]."""


class DropsConfig(PrintedPattern):
    """Round drops."""

    pattern: Literal["drops"] = "drops"
    """Round drops."""
    line_count: CountInterval = (1, 30)
    """Number of drops."""
    centre_m: Interval = (-0.024, 0.024)
    """Centre of a drop, along x and along y [m]."""
    line_width_m: PositiveInterval = (5e-4, 6e-3)
    """Diameter w [m]."""
    line_height_m: PositiveInterval = (1e-4, 1e-3)
    """Height H of the centre [m]."""


class TextConfig(PrintedPattern):
    """Text, written in single lines with the stroke font."""

    is_along_points: ClassVar[bool] = True
    pattern: Literal["text"] = "text"
    """Text in single lines."""
    text: Annotated[str, AfterValidator(_check_text)] = ""
    """What is written: capitals, digits and some signs; a newline begins another line. Empty draws characters."""
    characters: SomeInterval = (1, 6)
    """How many capitals and digits are drawn where no text is given."""
    cap_height_m: PositiveInterval = (5e-3, 0.015)
    """Height of a capital [m]."""
    angle_rad: AngleInterval = (-0.5, 0.5)
    """Direction of writing, from the x axis [rad]."""
    centre_m: Interval = (-8e-3, 8e-3)
    """Centre of the text, along x and along y [m]."""
    line_width_m: PositiveInterval = (4e-4, 1.5e-3)
    """Full width w [m]; the same for all strokes."""
    line_height_m: PositiveInterval = (1e-4, 6e-4)
    """Height H of the centre line [m]; the same for all strokes."""


def _pattern_of(value: Any) -> str:
    found = value.get("pattern", "lines") if isinstance(value, dict) else getattr(value, "pattern", "lines")
    return str(found)


PatternConfig = Annotated[
    Annotated[ReliefConfig, Tag("lines")]
    | Annotated[RasterConfig, Tag("raster")]
    | Annotated[RingsConfig, Tag("rings")]
    | Annotated[PictureConfig, Tag("picture")]
    | Annotated[PolylinesConfig, Tag("polylines")]
    | Annotated[CurvesConfig, Tag("curves")]
    | Annotated[MeandersConfig, Tag("meanders")]
    | Annotated[DropsConfig, Tag("drops")]
    | Annotated[TextConfig, Tag("text")],
    Discriminator(_pattern_of),
]
"""One of the patterns, told apart by its field ``pattern``; lines where that is missing."""

PATTERN_CONFIGS: dict[str, type[PrintedPattern]] = {
    "lines": ReliefConfig,
    "raster": RasterConfig,
    "rings": RingsConfig,
    "picture": PictureConfig,
    "polylines": PolylinesConfig,
    "curves": CurvesConfig,
    "meanders": MeandersConfig,
    "drops": DropsConfig,
    "text": TextConfig,
}
