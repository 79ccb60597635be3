"""A plate judged by its design, from the relief that was measured: zone, regions, fibres, verdict."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from warp_caustics.errors import InputError
from warp_caustics.inspection.compare import inspect_plate
from warp_caustics.inspection.fibres import fibre_findings
from warp_caustics.inspection.findings import Inspection
from warp_caustics.inspection.nominal import Nominal
from warp_caustics.prints.fit import FittedLine, fit_design
from warp_caustics.prints.model import LineModel
from warp_caustics.prints.tolerance import line_limit
from warp_caustics.reconstruct.trust import Trust
from warp_caustics.scene import Scene
from warp_caustics.types import BoolArray, FloatArray

UNKNOWN_SIGMA_M = 5e-6
"""Taken for the uncertainty of a relief that has none, where lines are fitted to it [m]."""


def judge_plate(
    heights_m: FloatArray,
    nominal: Nominal,
    scene: Scene,
    tolerance_m: float,
    *,
    sigma_m: FloatArray | None = None,
    fitted: Sequence[FittedLine] | None = None,
    mask: BoolArray | None = None,
    density_kg_m3: float | None = None,
) -> Inspection:
    """Judge a plate by its design.

    Of a design that is a list of lines the tolerance zone follows from the lines, and each line is judged; of any other
    it follows from the slope of the relief.

    Args:
        heights_m: measured relief [m], shape [n, n].
        nominal: what was to be printed.
        scene: gives plate size and glass.
        tolerance_m: largest distance from the nominal surface that is allowed [m].
        sigma_m: standard uncertainty of the measured relief [m], shape [n, n]; None if unknown.
        fitted: the design's lines as they were printed; None fits them to the relief.
        mask: True where the plate is judged, shape [n, n]; everywhere if None.
        density_kg_m3: of the glass [kg/m^3]; that of the scene's glass if None.

    Raises:
        InputError: shapes that differ, a tolerance of no length, an empty mask, or not one fit for each line.
    """
    compared = partial(
        inspect_plate,
        heights_m,
        nominal.relief_m,
        scene,
        tolerance_m,
        sigma_m=sigma_m,
        mask=mask,
        density_kg_m3=density_kg_m3,
    )
    lines, section = nominal.lines, nominal.section
    if not lines:
        return compared()
    if fitted is not None and len(fitted) != len(lines):
        raise InputError(f"{len(fitted)} fitted lines for {len(lines)} of the design; give one for each")
    zone = line_limit(lines, scene.height_samples, scene.plate_size_m, tolerance_m, section=section)
    plate = compared(limit_m=zone)
    assert plate.limit_m is not None
    if fitted is None:
        sigma = UNKNOWN_SIGMA_M + 0 * heights_m if sigma_m is None else sigma_m
        fitted = fit_design(LineModel(scene, section), lines, heights_m, sigma)
    fibres = fibre_findings(
        lines,
        fitted,
        plate.out_of_tolerance,
        plate.deviation_m,
        plate.limit_m,
        tolerance_m,
        scene.plate_size_m,
        section=section,
    )
    return compared(limit_m=zone, fibres=fibres)


def doubted(found: Inspection, trust: Trust | None) -> Inspection:
    """The same, but that no plate passes by heights that may be wrong by more than the relief."""
    if trust is None or not trust.is_beyond_relief or found.verdict != "pass":
        return found
    return replace(found, verdict="uncertain", reasons=(f"the image is {trust.line}", *found.reasons))
