"""Plates of Tab. 3 that were printed with one thing wrong, and whether an inspection found it.

Printed with 10 um of noise in height and 20 um in place. A plate has no defect or one: a fibre that is missing, lower
by 0.3 mm, displaced by 1 mm, half as wide again, or one that nobody designed. The fibre is one of some size: 8 mm long,
0.6 mm wide, 0.2 mm high; one that is to be lower is 0.5 mm high and 1.5 mm wide, since steep ones may be lower by much
within their zone.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from data_gen.config import ReliefConfig
from data_gen.patterns import draw_strokes
from warp_caustics.inspection.findings import Inspection
from warp_caustics.prints.line import Line, moved_across

HEIGHT_NOISE_M, PLACE_NOISE_M = 10e-6, 20e-6
DEFECTS = ("missing", "too low", "displaced", "extra", "too wide")
LACK_M, SHIFT_M, WIDER = 3e-4, 1e-3, 1.5
LENGTH_M, WIDTH_M, HEIGHT_M = 8e-3, 6e-4, 2e-4
WIDE_M, HIGH_M = 1.5e-3, 5e-4
"""Least size of a fibre that is wrong; the last two of one that is to be lower."""
NEAR_M = 1e-3
"""A defect counts as located where a finding is so near."""


@dataclass(frozen=True)
class PrintedPlate:
    """A plate as it was meant and as it is.

    Attributes:
        designed: lines of the design.
        printed: lines of the plate.
        defect: one of ``DEFECTS``; None for none.
        number: of the defective fibre, from 1; 0 if there is none in the design.
        at: lines near which the defect is.
    """

    designed: list[Line]
    printed: list[Line]
    defect: str | None
    number: int = 0
    at: tuple[Line, ...] = ()


def printed_plate(rng: np.random.Generator, defect: str | None) -> PrintedPlate:
    """Draw a plate.

    Args:
        rng: source of randomness.
        defect: one of ``DEFECTS``; None for none.
    """
    while True:
        designed = _drawn(rng)
        printed = [_as_printed(line, rng) for line in designed]
        if defect is None:
            return PrintedPlate(designed, printed, None)
        if defect == "extra":
            fibre = next((line for line in _drawn(rng) if _is_of_size(line)), None)
            if fibre is not None:
                return PrintedPlate(designed, [*printed, fibre], defect, 0, (fibre,))
            continue
        least = (WIDE_M, HIGH_M) if defect == "too low" else (WIDTH_M, HEIGHT_M)
        clear = [k for k, line in enumerate(designed) if _is_of_size(line, *least)]
        if not clear:
            continue
        k = clear[int(rng.integers(len(clear)))]
        printed[k] = _with(printed[k], defect)
        return PrintedPlate(designed, printed, defect, k + 1, (designed[k], printed[k]))


def _drawn(rng: np.random.Generator) -> list[Line]:
    return [Line((s[1], s[2]), (s[3], s[4]), s[5], s[6]) for s in draw_strokes(ReliefConfig(), rng).tolist()]


def _as_printed(line: Line, rng: np.random.Generator) -> Line:
    start, end = (tuple(np.add(each, rng.normal(0, PLACE_NOISE_M, 2)).tolist()) for each in (line.start_m, line.end_m))
    return Line(start, end, line.width_m, max(0.0, line.height_m + float(rng.normal(0, HEIGHT_NOISE_M))))


def _is_of_size(line: Line, width_m: float = WIDTH_M, height_m: float = HEIGHT_M) -> bool:
    length = np.hypot(*np.subtract(line.start_m, line.end_m))
    return bool(length > LENGTH_M and line.height_m > height_m and line.width_m > width_m)


def _with(line: Line, defect: str) -> Line:
    if defect == "missing":
        return replace(line, height_m=0.0)
    if defect == "too low":
        return replace(line, height_m=line.height_m - LACK_M)
    if defect == "too wide":
        return replace(line, width_m=WIDER * line.width_m)
    return moved_across(line, SHIFT_M, SHIFT_M)


def scored(plate: PrintedPlate, found: Inspection) -> dict[str, Any]:
    """The verdict, and whether the defect was found where it is, and named."""
    faults = {fibre.name: fibre.status for fibre in found.fibres if fibre.status not in ("as designed", "hidden")}
    row: dict[str, Any] = {
        "defect": plate.defect or "none",
        "lines": len(plate.designed),
        "verdict": found.verdict,
        "regions": len(found.regions),
        "faults": faults,
        "undecided": 0.0 if found.undecided is None else float(found.undecided.mean()),
    }
    if plate.defect is None:
        return row
    own = {name: status for name, status in faults.items() if _is_own(plate, name)}
    row["located"] = any(distance(region.centre_m, plate.at) < NEAR_M for region in found.regions)
    row["named"] = plate.defect in own.values()
    if plate.defect == "extra":
        row["named"] = row["named"] and any(
            distance(_middle(fibre.start_m, fibre.end_m), plate.at) < NEAR_M
            for fibre in found.fibres
            if fibre.status == "extra"
        )
    row["others_named"] = len(faults) - len(own)
    return row


def _is_own(plate: PrintedPlate, name: str) -> bool:
    return name.startswith("extra") if plate.defect == "extra" else name == str(plate.number)


def _middle(start_m: tuple[float, float], end_m: tuple[float, float]) -> tuple[float, float]:
    x, y = np.add(start_m, end_m) / 2
    return float(x), float(y)


def distance(point_m: tuple[float, float], lines: Sequence[Line]) -> float:
    """From a point to the nearest of the lines [m]."""
    distances = []
    for line in lines:
        along = np.subtract(line.end_m, line.start_m)
        t = np.clip(np.dot(np.subtract(point_m, line.start_m), along) / np.dot(along, along), 0, 1)
        distances.append(float(np.hypot(*(np.subtract(point_m, line.start_m) - t * along))))
    return min(distances)
