"""Distributions of printed reliefs: Tab. 3 of the supplement, and other print patterns.

Everything is in metres; (0, 0) is the centre of the plate. Each pair is an
interval (lowest, highest) from which values are drawn uniformly.
"""

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Discriminator, Field, Tag, model_validator

from data_gen.variety import PrintVariety
from warp_caustics.prints.line import MAX_LINES, MAX_SUPERSAMPLING, Section
from warp_caustics.strict import Finite, Strict

MAX_LENGTH_M = 1.0
MAX_PICTURE_CELLS = 1_000_000
MAX_MERGING_SUPERSAMPLING = 8
"""With lines that merge each thread of the printing kernel keeps supersampling^2 sums."""


def _check_interval(value: tuple[float, float]) -> tuple[float, float]:
    low, high = value
    if low > high:
        raise ValueError(f"lower end {low:g} is above upper end {high:g}; swap them")
    if max(abs(low), abs(high)) > MAX_LENGTH_M:
        raise ValueError(f"({low:g}, {high:g}) m reaches beyond {MAX_LENGTH_M:g} m; give metres")
    return value


def _check_positive(value: tuple[float, float]) -> tuple[float, float]:
    if value[0] <= 0:
        raise ValueError(f"lower end {value[0]:g} m is not above 0; a printed line has a width and a height")
    return value


def _check_angles(value: tuple[float, float]) -> tuple[float, float]:
    low, high = value
    if not -7 <= low <= high <= 7:
        raise ValueError(f"({low:g}, {high:g}) rad is no interval between -7 and 7; give radians, the lower end first")
    return value


def _check_count(value: tuple[int, int]) -> tuple[int, int]:
    low, high = value
    if not 0 <= low <= high <= MAX_LINES:
        raise ValueError(f"({low}, {high}) lines; give 0 <= lowest <= highest <= {MAX_LINES}")
    return value


def _check_picture(rows: tuple[str, ...]) -> tuple[str, ...]:
    if len({len(row) for row in rows}) != 1 or not rows[0]:
        raise ValueError("picture rows differ in length or are empty; give rows of equal length")
    if set("".join(rows)) - set("#."):
        raise ValueError("picture rows hold other characters than # (fibre) and . (bare plate)")
    if len(rows) * len(rows[0]) > MAX_PICTURE_CELLS:
        raise ValueError(f"picture of {len(rows)} x {len(rows[0])} is too large; use {MAX_PICTURE_CELLS} cells at most")
    return rows


Interval = Annotated[tuple[Finite, Finite], AfterValidator(_check_interval)]
PositiveInterval = Annotated[Interval, AfterValidator(_check_positive)]
AngleInterval = Annotated[tuple[Finite, Finite], AfterValidator(_check_angles)]
CountInterval = Annotated[tuple[int, int], AfterValidator(_check_count)]


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

    @model_validator(mode="after")
    def _merging_fits(self) -> "PrintedPattern":
        if self.variety is not None and self.variety.merging_share and self.supersampling > MAX_MERGING_SUPERSAMPLING:
            raise ValueError(
                f"supersampling {self.supersampling} with lines that merge; use {MAX_MERGING_SUPERSAMPLING} at most, "
                "or variety.merging_share 0"
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


def _pattern_of(value: Any) -> str:
    found = value.get("pattern", "lines") if isinstance(value, dict) else getattr(value, "pattern", "lines")
    return str(found)


PatternConfig = Annotated[
    Annotated[ReliefConfig, Tag("lines")]
    | Annotated[RasterConfig, Tag("raster")]
    | Annotated[RingsConfig, Tag("rings")]
    | Annotated[PictureConfig, Tag("picture")],
    Discriminator(_pattern_of),
]
"""One of the patterns, told apart by its field ``pattern``; lines where that is missing."""

PATTERN_CONFIGS: dict[str, type[PrintedPattern]] = {
    "lines": ReliefConfig,
    "raster": RasterConfig,
    "rings": RingsConfig,
    "picture": PictureConfig,
}
