"""A measured plate compared with its design: deviation, regions, volume, verdict and why."""

from collections.abc import Sequence

import numpy as np
import scipy.ndimage

from warp_caustics.errors import InputError
from warp_caustics.inspection.findings import FibreFinding, Inspection, Region, Verdict
from warp_caustics.inspection.regions import regions
from warp_caustics.inspection.tolerance import COVERAGE_FACTOR, SMALLEST_CELLS, level, ridges, vertical_limit, zones
from warp_caustics.materials import density
from warp_caustics.reconstruct.volume import relief_volume
from warp_caustics.scene import Scene
from warp_caustics.types import BoolArray, FloatArray

NOTABLE_LEVEL_M = 1e-6
"""An offset of the level above this is a warning [m]."""
MAX_NAMED_REGIONS = 10
"""Regions that are described in words; all are in the tables."""
FAULTS = ("missing", "extra", "too high", "too low", "too wide", "too narrow", "displaced")


def inspect_plate(
    heights_m: FloatArray,
    nominal_m: FloatArray,
    scene: Scene,
    tolerance_m: float,
    *,
    sigma_m: FloatArray | None = None,
    mask: BoolArray | None = None,
    fibres: Sequence[FibreFinding] = (),
    limit_m: FloatArray | None = None,
    density_kg_m3: float | None = None,
    coverage: float = COVERAGE_FACTOR,
    smallest_cells: int = SMALLEST_CELLS,
    warnings: Sequence[str] = (),
) -> Inspection:
    """Compare a plate with its design.

    Args:
        heights_m: measured relief [m], shape [n, n].
        nominal_m: the design's relief [m], shape [n, n].
        scene: gives plate size and glass.
        tolerance_m: largest distance from the nominal surface that is allowed [m].
        sigma_m: standard uncertainty of the measured relief [m], shape [n, n]; None if unknown.
        mask: True where the plate is judged, shape [n, n]; everywhere if None.
        fibres: what is known of each fibre; one that is not as designed fails the plate.
        limit_m: largest vertical deviation allowed [m], shape [n, n], where the design knows more than its samples
            tell; where :func:`~warp_caustics.inspection.tolerance.vertical_limit` allows more, that counts.
        density_kg_m3: of the glass [kg/m^3]; that of the scene's glass if None.
        coverage: k, see :func:`~warp_caustics.inspection.tolerance.zones`.
        smallest_cells: parts of fewer cells are not told from errors of the measurement.
        warnings: passed on.

    Raises:
        InputError: shapes that differ, a tolerance of no length, or an empty mask.
    """
    n = scene.height_samples
    for name, array in (("heights", heights_m), ("nominal heights", nominal_m), ("uncertainty", sigma_m)):
        if array is not None and array.shape != (n, n):
            raise InputError(f"{name} have shape {list(array.shape)}, the scene [{n}, {n}]; resample them")
    for name, array in (("heights", heights_m), ("nominal heights", nominal_m)):
        if not np.isfinite(array).all():
            raise InputError(f"{name} are no numbers at {int((~np.isfinite(array)).sum())} places; measure again")
    if not (np.isfinite(tolerance_m) and tolerance_m > 0):
        raise InputError(f"tolerance {tolerance_m:g} m is not above 0; give a length such as 50um")
    judged = np.ones((n, n), bool) if mask is None else mask
    if judged.shape != (n, n) or not judged.any():
        raise InputError(f"mask of shape {list(judged.shape)} with {int(judged.sum())} cells; mark some of [{n}, {n}]")
    deviation = heights_m.astype(np.float64) - nominal_m
    offset, where = level(deviation, nominal_m, judged)
    deviation = deviation - offset
    limit = vertical_limit(nominal_m, tolerance_m, scene.sample_pitch_m)
    if limit_m is not None:
        limit = np.maximum(limit, limit_m)
    found = zones(deviation, sigma_m, limit, judged, coverage=coverage, smallest_cells=smallest_cells)
    parts = regions(found.out, np.where(judged, deviation, 0.0), limit, scene.plate_size_m)
    cell = scene.sample_pitch_m[0] * scene.sample_pitch_m[1]
    volume = relief_volume(nominal_m + deviation, scene.sample_pitch_m)
    told = list(warnings)
    if abs(offset) > NOTABLE_LEVEL_M:
        told.append(f"the level was moved by {-offset * 1e6:.3g} um, so that the median over {where} is as designed")
    narrow = ridges(nominal_m, tolerance_m) & judged
    if limit_m is None and narrow.any():
        told.append(
            f"{narrow.sum() * cell * 1e6:.3g} mm^2 of the design are ridges narrower than two samples; fibres there "
            "may seem out of tolerance though they lie within, give the design as a list of lines"
        )
    if sigma_m is None:
        told.append("the method gives no uncertainty; every deviation beyond tolerance counts as certain")
    verdict, reasons = _verdict(parts, fibres, found.undecided, cell, deviation[judged], tolerance_m)
    if found.specks.any() and verdict != "fail":
        reasons.append(_speck_reason(found.specks, deviation, smallest_cells, cell))
    if density_kg_m3 is None:
        density_kg_m3 = density(scene.glass)
        if density_kg_m3 is None:
            told.append(f"the density of glass {scene.glass!r} is not known, so no mass; give --density")
    return Inspection(
        verdict=verdict,
        reasons=tuple(reasons),
        tolerance_m=tolerance_m,
        nominal_m=nominal_m,
        deviation_m=deviation,
        mask=judged,
        out_of_tolerance=found.out,
        regions=parts,
        fibres=tuple(fibres),
        volume_m3=volume,
        nominal_volume_m3=relief_volume(nominal_m, scene.sample_pitch_m),
        mass_kg=float("nan") if density_kg_m3 is None else volume * density_kg_m3,
        warnings=tuple(told),
        undecided=found.undecided,
        limit_m=limit,
    )


def _verdict(
    parts: Sequence[Region],
    fibres: Sequence[FibreFinding],
    undecided: BoolArray,
    cell_m2: float,
    deviation_m: FloatArray,
    tolerance_m: float,
) -> tuple[Verdict, list[str]]:
    reasons = []
    for fibre in fibres:
        if fibre.status in FAULTS:
            reasons.append(_fibre_reason(fibre))
    for region in parts[:MAX_NAMED_REGIONS]:
        reasons.append(_region_reason(region))
    if len(parts) > MAX_NAMED_REGIONS:
        reasons.append(f"{len(parts) - MAX_NAMED_REGIONS} more regions out of tolerance")
    if reasons:
        return "fail", reasons
    hidden = [fibre.name for fibre in fibres if fibre.status == "hidden"]
    if undecided.any():
        reasons.append(
            f"on {undecided.sum() * cell_m2 * 1e6:.3g} mm^2 the measurement is too uncertain to tell whether the plate "
            f"is within {tolerance_m * 1e6:g} um"
        )
    if hidden:
        reasons.append(f"fibre {', '.join(hidden)} cannot be told from the others")
    if reasons:
        return "uncertain", reasons
    return "pass", [
        f"no part of the plate that is judged is out of {tolerance_m * 1e6:g} um; RMS deviation "
        f"{np.sqrt(np.mean(deviation_m**2)) * 1e6:.3g} um, largest {np.abs(deviation_m).max() * 1e6:.3g} um"
    ]


def _speck_reason(specks: BoolArray, deviation_m: FloatArray, smallest_cells: int, cell_m2: float) -> str:
    """What a verdict leaves out of account."""
    parts = scipy.ndimage.label(specks, structure=np.ones((3, 3)))[1]
    return (
        f"not judged: {parts} part{'' if parts == 1 else 's'} beyond tolerance (up to "
        f"{np.abs(deviation_m[specks]).max() * 1e6:.3g} um), each of fewer than {smallest_cells} samples "
        f"({smallest_cells * cell_m2 * 1e6:.2g} mm^2), which errors of the measurement may be"
    )


def _fibre_reason(fibre: FibreFinding) -> str:
    place = f"from ({_mm(fibre.start_m)}) to ({_mm(fibre.end_m)}) mm"
    if fibre.status == "displaced":
        return f"fibre {fibre.name} is displaced by {fibre.displacement_m * 1e6:.0f} um, {place}"
    if fibre.status in ("too wide", "too narrow"):
        return f"fibre {fibre.name} is {abs(fibre.width_error_m) * 1e6:.0f} um {fibre.status}, {place}"
    if fibre.status in ("too high", "too low"):
        return f"fibre {fibre.name} is {abs(fibre.height_error_m) * 1e6:.0f} um {fibre.status}, {place}"
    if fibre.status == "extra":
        return f"{fibre.name} fibre, not in the design, {place}"
    return f"fibre {fibre.name} is missing, {place}"


def _region_reason(region: Region) -> str:
    much = "too much" if region.peak_m > 0 else "too little"
    return (
        f"region {region.number}: {much} glass, up to {abs(region.peak_m) * 1e6:.0f} um, "
        f"{region.area_m2 * 1e6:.3g} mm^2 around ({_mm(region.centre_m)}) mm, {region.volume_m3 * 1e9:+.3g} mm^3"
    )


def _mm(point_m: tuple[float, float]) -> str:
    return f"{point_m[0] * 1e3:.1f}, {point_m[1] * 1e3:.1f}"
