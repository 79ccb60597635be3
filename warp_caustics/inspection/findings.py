"""What an inspection found, as records."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from warp_caustics.inspection.place import Place
from warp_caustics.types import FloatArray

Verdict = Literal["pass", "fail", "uncertain"]
FibreStatus = Literal[
    "as designed", "missing", "extra", "too high", "too low", "too wide", "too narrow", "displaced", "hidden"
]


@dataclass(frozen=True)
class Region:
    """A connected part of the plate that is out of tolerance.

    Attributes:
        number: from 1, largest volume first.
        centre_m: (x, y) of the centre of the excess volume [m], from the plate's centre.
        lower_m: (x, y) of the lower corner of its bounding box [m].
        upper_m: (x, y) of the upper corner [m].
        area_m2: [m^2].
        volume_m3: printed minus nominal [m^3]; negative where glass is missing.
        peak_m: largest deviation [m], with its sign.
    """

    number: int
    centre_m: tuple[float, float]
    lower_m: tuple[float, float]
    upper_m: tuple[float, float]
    area_m2: float
    volume_m3: float
    peak_m: float


@dataclass(frozen=True)
class FibreFinding:
    """A fibre of the design, or one that is not in it.

    Attributes:
        name: as the design numbers it, from 1; ``"extra 1"`` for one that is not in it.
        status: what is the matter with it.
        start_m: (x, y) of one end of its nominal centre line [m]; of an extra one, where it was found.
        end_m: (x, y) of the other end [m].
        height_error_m: measured minus nominal height on the centre line [m]; NaN if it cannot be told.
        displacement_m: distance of the measured centre line from the nominal one [m], across it; NaN likewise.
        volume_m3: measured volume [m^3]; NaN likewise.
        width_error_m: measured minus nominal width [m]; 0 where no other width was found, NaN if it cannot be told.
    """

    name: str
    status: FibreStatus
    start_m: tuple[float, float]
    end_m: tuple[float, float]
    height_error_m: float
    displacement_m: float
    volume_m3: float
    width_error_m: float = 0.0


@dataclass(frozen=True, eq=False)
class Inspection:
    """A plate compared with its design.

    Attributes:
        verdict: ``"uncertain"`` when the measurement cannot decide.
        reasons: one line each.
        tolerance_m: largest deviation allowed [m].
        nominal_m: the design's relief [m], shape [n, n].
        deviation_m: measured minus nominal [m], shape [n, n].
        mask: True where the plate is judged, shape [n, n].
        out_of_tolerance: True where the deviation is beyond tolerance and its uncertainty, shape [n, n].
        regions: connected parts of that, largest volume first.
        fibres: empty if the design is no list of lines.
        volume_m3: printed volume above the base [m^3].
        nominal_volume_m3: the design's [m^3].
        mass_kg: printed mass [kg].
        warnings: what a person should know.
        undecided: True where the measurement cannot tell, shape [n, n]; None if that was not asked.
        limit_m: largest vertical deviation allowed [m], shape [n, n]: the tolerance along the surface's normal.
        place: where the whole picture lies against the design, which ``nominal_m`` was moved by; None if that was not
            asked.
    """

    verdict: Verdict
    reasons: tuple[str, ...]
    tolerance_m: float
    nominal_m: FloatArray
    deviation_m: FloatArray
    mask: npt.NDArray[np.bool_]
    out_of_tolerance: npt.NDArray[np.bool_]
    regions: tuple[Region, ...]
    fibres: tuple[FibreFinding, ...]
    volume_m3: float
    nominal_volume_m3: float
    mass_kg: float
    warnings: tuple[str, ...] = ()
    undecided: npt.NDArray[np.bool_] | None = None
    limit_m: FloatArray | None = None
    place: Place | None = None
