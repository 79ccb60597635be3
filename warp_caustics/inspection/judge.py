"""A plate judged by its design, from the relief that was measured: zone, regions, fibres, verdict."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from warp_caustics.errors import InputError
from warp_caustics.inspection.compare import inspect_plate
from warp_caustics.inspection.fibres import fibre_findings
from warp_caustics.inspection.findings import Inspection
from warp_caustics.inspection.nominal import Nominal
from warp_caustics.inspection.place import Place, found_place, moved_design
from warp_caustics.inspection.tolerance import COVERAGE_FACTOR, level
from warp_caustics.prints.fit_design import FittedLine, fit_design
from warp_caustics.prints.line import Line, direction
from warp_caustics.prints.model import LineModel
from warp_caustics.prints.tolerance import line_limit
from warp_caustics.reconstruct.trust import Trust
from warp_caustics.scene import Scene
from warp_caustics.types import BoolArray, FloatArray

NOTABLE_GAIN_M = 5e-6
"""A factor on all heights is told of from where it makes so much of the highest [m]."""
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
    is_placed: bool = False,
) -> Inspection:
    """Judge a plate by its design.

    What the whole picture is moved, turned or larger by is found first (:mod:`~warp_caustics.inspection.place`) and the
    design moved along, so that it is not taken for fibres that are displaced. A factor on all heights, which a bench
    other than told makes as well as the print, counts as uncertain and not as out of tolerance. Of a design that is a
    list of lines the tolerance zone follows from the lines, and each line is judged; of any other it follows from the
    slope of the relief.

    Args:
        heights_m: measured relief [m], shape [n, n].
        nominal: what was to be printed.
        scene: gives plate size and glass.
        tolerance_m: largest distance from the nominal surface that is allowed [m].
        sigma_m: standard uncertainty of the measured relief [m], shape [n, n]; None if unknown.
        fitted: the design's lines as they were printed; None fits them to the relief.
        mask: True where the plate is judged, shape [n, n]; everywhere if None.
        density_kg_m3: of the glass [kg/m^3]; that of the scene's glass if None.
        is_placed: the picture lies where the design says; nothing is looked for.

    Raises:
        InputError: shapes that differ, a tolerance of no length, an empty mask, or not one fit for each line.
    """
    if fitted is not None and nominal.lines and len(fitted) != len(nominal.lines):
        raise InputError(f"{len(fitted)} fitted lines for {len(nominal.lines)} of the design; give one for each")
    place: Place | None = None
    gain = 0.0
    told: tuple[str, ...] = ()
    if not is_placed and _can_be_placed(heights_m, nominal, scene, mask):
        place = _place_of(heights_m, nominal, scene, sigma_m, mask)
        sure = place.significant()
        gain, told = abs(sure.gain), _told_of(sure, nominal)
        nominal = moved_design(nominal, sure, scene)
        fitted = None if fitted is None else tuple(map(_against, fitted, nominal.lines))
        if gain:
            sigma_m = np.hypot(0.0 if sigma_m is None else sigma_m, gain / COVERAGE_FACTOR * nominal.relief_m)
    compared = partial(
        inspect_plate,
        heights_m,
        nominal.relief_m,
        scene,
        tolerance_m,
        sigma_m=sigma_m,
        mask=mask,
        density_kg_m3=density_kg_m3,
        warnings=told,
    )
    lines, section = nominal.lines, nominal.section
    if not lines:
        return replace(compared(), place=place)
    zone = line_limit(lines, scene.height_samples, scene.plate_size_m, tolerance_m, section=section)
    plate = compared(limit_m=zone)
    assert plate.limit_m is not None
    if fitted is None:
        sigma = UNKNOWN_SIGMA_M + 0 * heights_m if sigma_m is None else sigma_m
        fitted = fit_design(LineModel(scene, section), lines, heights_m, sigma)
    if gain:
        fitted = [_unsure_by(gain / COVERAGE_FACTOR, fit, line) for fit, line in zip(fitted, lines, strict=True)]
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
    return replace(compared(limit_m=zone, fibres=fibres), place=place)


def _can_be_placed(heights_m: FloatArray, nominal: Nominal, scene: Scene, mask: BoolArray | None) -> bool:
    """Whether shapes are such that a comparison does not refuse them."""
    shape = (scene.height_samples, scene.height_samples)
    fits = heights_m.shape == shape and nominal.relief_m.shape == shape and (mask is None or mask.shape == shape)
    return fits and bool(np.isfinite(heights_m).all() and np.isfinite(nominal.relief_m).all())


def _place_of(
    heights_m: FloatArray, nominal: Nominal, scene: Scene, sigma_m: FloatArray | None, mask: BoolArray | None
) -> Place:
    judged = np.ones(heights_m.shape, bool) if mask is None else mask
    if not judged.any():
        return Place()
    offset, _ = level(heights_m - nominal.relief_m, nominal.relief_m, judged)
    return found_place(heights_m - offset, nominal, scene, sigma_m=sigma_m, mask=judged)


def _told_of(place: Place, nominal: Nominal) -> tuple[str, ...]:
    """What a person should know of it."""
    highest = float(nominal.relief_m.max())
    if abs(place.gain) * highest <= NOTABLE_GAIN_M:
        return ()
    more = "higher" if place.gain > 0 else "lower"
    return (
        f"all heights are {100 * abs(place.gain):.2g} +- {100 * place.sigma[4]:.1g} % {more} than designed, as by a "
        "gap, base or index other than told, or by the print: up to so much, nothing is shown to be in or out of "
        "tolerance; measure the bench, or take reconstruction.options.set_up=estimate",
    )


def _unsure_by(share: float, fit: FittedLine, line: Line) -> FittedLine:
    """A fitted line whose height may be off by a share of the designed one."""
    return replace(fit, height_std_m=math.hypot(fit.height_std_m, share * line.height_m))


def _against(fit: FittedLine, line: Line) -> FittedLine:
    """A fitted line with its displacement from a design that was moved along."""
    c, s = direction(line)
    aside = [
        (found[1] - meant[1]) * c - (found[0] - meant[0]) * s
        for found, meant in ((fit.line.start_m, line.start_m), (fit.line.end_m, line.end_m))
    ]
    return replace(fit, displacement_m=sum(aside) / 2)


def doubted(found: Inspection, trust: Trust | None) -> Inspection:
    """The same, but that no plate passes by heights that may be wrong by more than the relief."""
    if trust is None or not trust.is_beyond_relief or found.verdict != "pass":
        return found
    return replace(found, verdict="uncertain", reasons=(f"the image is {trust.line}", *found.reasons))
