"""Distribution of the printed reliefs: Tab. 3 of the supplement.

Everything is in metres; (0, 0) is the centre of the plate. Each pair is an
interval (lowest, highest) from which values are drawn uniformly.
"""

from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

MAX_LINES = 10_000
MAX_LENGTH_M = 1.0
MAX_SUPERSAMPLING = 64


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


def _check_count(value: tuple[int, int]) -> tuple[int, int]:
    low, high = value
    if not 0 <= low <= high <= MAX_LINES:
        raise ValueError(f"({low}, {high}) lines; give 0 <= lowest <= highest <= {MAX_LINES}")
    return value


Finite = Annotated[float, Field(allow_inf_nan=False)]
Interval = Annotated[tuple[Finite, Finite], AfterValidator(_check_interval)]
PositiveInterval = Annotated[Interval, AfterValidator(_check_positive)]
CountInterval = Annotated[tuple[int, int], AfterValidator(_check_count)]

Profile = Literal["cosine", "quarter"]
"""``cosine``: H/2 (1 + cos(2 pi r / w)); ``quarter``: H cos(pi r / w); both 0 from r = w/2 on."""


class Perturbation(BaseModel):
    """Offsets added to a line for the updater's data set (last column of Tab. 3)."""

    model_config = ConfigDict(frozen=True, extra="forbid", validate_default=True)

    line_start_m: Interval = (-2.5e-3, 2.5e-3)
    """Offset of the start, along x and along y [m]."""
    line_end_m: Interval = (-2.5e-3, 2.5e-3)
    """Offset of the end, along x and along y [m]."""
    line_width_m: Interval = (-1e-3, 1e-3)
    line_height_m: Interval = (-1e-3, 1e-3)


class ReliefConfig(BaseModel):
    """Parameter ranges of Tab. 3, validated and immutable; unknown fields are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", validate_default=True)

    line_count: CountInterval = (2, 30)
    """Number of lines, both ends included."""
    line_start_m: Interval = (-0.025, 0.025)
    """Where a line starts, along x and along y [m]."""
    line_end_m: Interval = (-0.025, 0.025)
    """Where a line ends, along x and along y [m]."""
    line_width_m: PositiveInterval = (1e-4, 4e-3)
    """Full width w [m]."""
    line_height_m: PositiveInterval = (1e-4, 2e-3)
    """Height H of the centre line [m]."""
    perturbation: Perturbation = Perturbation()
    smallest_width_m: Annotated[Finite, Field(gt=0, le=MAX_LENGTH_M)] = 1e-4
    """A perturbed width below is raised to it [m]; a perturbed height below 0 becomes 0, a missing fibre.

    Tab. 3's offsets make 15 % of the lines non-positive in width or height and the paper does not say what
    becomes of them."""
    profile: Profile = "cosine"
    supersampling: Annotated[int, Field(ge=1, le=MAX_SUPERSAMPLING)] = 4
    """A height sample is the mean of supersampling^2 points of its cell; 7.5 % of the lines are narrower."""

    @model_validator(mode="after")
    def _perturbed_width(self) -> "ReliefConfig":
        if self.smallest_width_m > self.line_width_m[1]:
            raise ValueError(
                f"smallest_width_m {self.smallest_width_m:g} exceeds the widest line {self.line_width_m[1]:g}; lower it"
            )
        return self
