"""What is the matter with each fibre of a printed plate: missing, too high, displaced; and fibres nobody designed.

Judged are the lines as they were found (``prints.fit_design``). A fault counts only
where the plate is out of tolerance: a fibre whose measured numbers are odd
while the relief around it is as designed was not measured well enough, no more.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import skimage.measure

from warp_caustics.height_field import cell_centres
from warp_caustics.inspection.findings import FibreFinding, FibreStatus
from warp_caustics.inspection.tolerance import COVERAGE_FACTOR, SMALLEST_CELLS
from warp_caustics.prints.fit_design import LARGEST_OFFSET_M, FittedLine
from warp_caustics.prints.line import Line, Section, line_patch, line_relief
from warp_caustics.types import BoolArray, FloatArray

MISSING_SHARE = 0.3
"""A fibre with less than this share of its height is missing."""
FOOT_SHARE = 0.1
"""A fibre is where it has at least this share of its height."""
EXTRA_LENGTH_M = 2e-3
"""A fibre that is not designed is at least so long [m]; shorter is a blob."""
SAME_DIRECTION_DEG = 5.0
"""An extra fibre beside a missing one is that one where their directions differ by no more."""
EXTRA_ELONGATION = 2.5
"""And so many times as long as wide."""


def fibre_findings(
    lines: Sequence[Line],
    fitted: Sequence[FittedLine],
    out: BoolArray,
    deviation_m: FloatArray,
    limit_m: FloatArray,
    tolerance_m: float,
    plate_size_m: tuple[float, float],
    *,
    section: Section = "cosine",
    coverage: float = COVERAGE_FACTOR,
) -> tuple[FibreFinding, ...]:
    """What is the matter with each line, and what was printed besides.

    Args:
        lines: as designed.
        fitted: as found, one for each.
        out: where the plate is certainly out of tolerance, shape [n, n].
        deviation_m: measured minus nominal [m], shape [n, n].
        limit_m: largest vertical deviation allowed [m], shape [n, n].
        tolerance_m: of heights and of places [m].
        plate_size_m: extent along x and y [m].
        section: of the lines.
        coverage: k, how many standard uncertainties make certain.
    """
    n = len(out)
    findings = [
        _finding(number, line, fit, out, tolerance_m, plate_size_m, section, coverage)
        for number, (line, fit) in enumerate(zip(lines, fitted, strict=True), 1)
    ]
    nominal = line_relief(lines, n, plate_size_m, section=section)
    explained = line_relief([fit.line for fit in fitted], n, plate_size_m, section=section) - nominal
    return _moved(findings, _extras(out, deviation_m, explained, limit_m, plate_size_m))


def _moved(findings: Sequence[FibreFinding], extras: Sequence[FibreFinding]) -> tuple[FibreFinding, ...]:
    """Fibres and extra ones, of which one that lies beside a missing fibre is that fibre, displaced."""
    told, left = list(findings), list(extras)
    for k, fibre in enumerate(told):
        if fibre.status != "missing":
            continue
        beside = [(abs(aside), extra) for extra in left if (aside := _aside(fibre, extra)) is not None]
        if beside:
            distance, extra = min(beside, key=lambda each: each[0])
            left.remove(extra)
            told[k] = replace(
                fibre, status="displaced", height_error_m=math.nan, displacement_m=distance, volume_m3=extra.volume_m3
            )
    return (*told, *(replace(extra, name=f"extra {number}") for number, extra in enumerate(left, 1)))


def _aside(fibre: FibreFinding, extra: FibreFinding) -> float | None:
    """How far an extra fibre lies beside a designed one [m]; None where it is another."""
    start, end, a, b = (np.array(p) for p in (fibre.start_m, fibre.end_m, extra.start_m, extra.end_m))
    length = float(np.hypot(*(end - start)))
    if length <= 0:
        return None
    along = (end - start) / length
    found = (b - a) / max(float(np.hypot(*(b - a))), 1e-12)
    middle = (a + b) / 2 - start
    across = float(along[0] * middle[1] - along[1] * middle[0])
    is_parallel = abs(float(along @ found)) > math.cos(math.radians(SAME_DIRECTION_DEG))
    is_beside = 0 <= float(along @ middle) <= length and abs(across) <= LARGEST_OFFSET_M
    return across if is_parallel and is_beside else None


def _finding(
    number: int,
    line: Line,
    fit: FittedLine,
    out: BoolArray,
    tolerance_m: float,
    plate_size_m: tuple[float, float],
    section: Section,
    coverage: float,
) -> FibreFinding:
    status: FibreStatus = "as designed"
    height_error, displacement = fit.height_error_m, abs(fit.displacement_m)
    can_be_seen = coverage * fit.height_std_m <= max(line.height_m, tolerance_m)
    if not can_be_seen and line.height_m > tolerance_m:
        status = "hidden"
    elif _cells_out(line, fit.line, out, plate_size_m, section) >= SMALLEST_CELLS:
        if fit.line.height_m < MISSING_SHARE * line.height_m and -height_error > tolerance_m:
            status = "missing"
        elif displacement - coverage * fit.displacement_std_m > tolerance_m:
            status = "displaced"
        elif _is_of_other_width(fit, line, tolerance_m, coverage):
            status = "too wide" if fit.width_error_m > 0 else "too narrow"
        elif abs(height_error) - coverage * fit.height_std_m > tolerance_m:
            status = "too high" if height_error > 0 else "too low"
    volume = _volume(fit.line, len(out), plate_size_m, section)
    width_error = fit.width_error_m
    if status == "hidden":
        height_error = displacement = volume = width_error = math.nan
    if status == "missing":
        displacement = width_error = math.nan
    return FibreFinding(str(number), status, line.start_m, line.end_m, height_error, displacement, volume, width_error)


def _is_of_other_width(fit: FittedLine, line: Line, tolerance_m: float, coverage: float) -> bool:
    """Whether its edges are out of tolerance, and its width differs by more of itself than its height."""
    error = abs(fit.width_error_m)
    if error == 0 or error / 2 - coverage * fit.width_std_m / 2 <= tolerance_m:
        return False
    return error / line.width_m > abs(fit.height_error_m) / max(line.height_m, 1e-12)


def _cells_out(line: Line, found: Line, out: BoolArray, plate_size_m: tuple[float, float], section: Section) -> int:
    """Cells out of tolerance where the line was meant, or is."""
    where = np.zeros_like(out)
    for each in (line, found):
        rows, columns, patch = line_patch(each, len(out), plate_size_m, section=section)
        where[rows, columns] |= patch > FOOT_SHARE * max(each.height_m, 1e-12)
    return int((where & out).sum())


def _volume(line: Line, n: int, plate_size_m: tuple[float, float], section: Section) -> float:
    *_, patch = line_patch(line, n, plate_size_m, section=section)
    return float(patch.sum()) * plate_size_m[0] * plate_size_m[1] / n**2


def _extras(
    out: BoolArray,
    deviation_m: FloatArray,
    explained_m: FloatArray,
    limit_m: FloatArray,
    plate_size_m: tuple[float, float],
) -> list[FibreFinding]:
    """Long regions with too much glass that no line of the design explains."""
    left = deviation_m - explained_m
    labels = skimage.measure.label((left > limit_m) & (deviation_m > limit_m), connectivity=2)
    n = len(out)
    x, y = (cell_centres(n, length) for length in plate_size_m)
    pitch_x, pitch_y = plate_size_m[0] / n, plate_size_m[1] / n
    findings: list[FibreFinding] = []
    for part in skimage.measure.regionprops(labels):
        rows, columns = part.coords.T
        if out[rows, columns].sum() < SMALLEST_CELLS:
            continue
        points = np.stack([x[columns], y[rows]], axis=1)
        weight = left[rows, columns]
        centre = np.average(points, axis=0, weights=weight)
        spread, axes = np.linalg.eigh(
            np.cov((points - centre).T, aweights=weight) + np.diag([pitch_x, pitch_y]) ** 2 / 12
        )
        along = (points - centre) @ axes[:, 1]
        if np.ptp(along) < EXTRA_LENGTH_M or spread[1] < EXTRA_ELONGATION**2 * spread[0]:
            continue
        start, end = (centre + reach * axes[:, 1] for reach in (along.min(), along.max()))
        findings.append(
            FibreFinding(
                f"extra {len(findings) + 1}",
                "extra",
                (float(start[0]), float(start[1])),
                (float(end[0]), float(end[1])),
                float(weight.max()),
                math.nan,
                float(weight.sum() * pitch_x * pitch_y),
            )
        )
    return findings
