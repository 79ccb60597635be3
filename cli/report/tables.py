"""Tables of the page, as rows of text."""

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from cli.report.number import number
from cli.report.summary import mapping

if TYPE_CHECKING:
    from cli.report.content import ReportContent
    from warp_caustics.inspection.findings import Inspection
    from warp_caustics.scene import Scene
    from warp_caustics.types import FloatArray

MAX_TEXT = 300
"""Characters of a setting that is shown."""


def region_rows(found: "Inspection") -> list[list[str]]:
    """Number, centre x and y [mm], size x and y [mm], area [mm^2], volume [mm^3], peak [um]."""
    return [
        [
            str(region.number),
            number(region.centre_m[0] * 1e3),
            number(region.centre_m[1] * 1e3),
            number((region.upper_m[0] - region.lower_m[0]) * 1e3),
            number((region.upper_m[1] - region.lower_m[1]) * 1e3),
            number(region.area_m2 * 1e6),
            number(region.volume_m3 * 1e9),
            number(region.peak_m * 1e6),
        ]
        for region in found.regions
    ]


def bench_rows(record: Mapping[str, Any]) -> list[list[str]]:
    """Name, told, used, standard deviation, unit, verdict of each number; none where they were not looked for."""
    numbers = mapping(mapping(record.get("counters")).get("bench")).get("numbers") or []
    return [
        [
            str(each["name"]),
            number(each["told"], 4),
            number(each["found"], 4),
            number(each["sigma"], 2),
            str(each["unit"]),
            f"{each['verdict']}: {each['why']}" if each["why"] else str(each["verdict"]),
        ]
        for each in map(mapping, numbers)
    ]


def fibre_rows(found: "Inspection") -> list[list[str]]:
    """Name, status, ends [mm], height error [um], displacement [um], volume [mm^3]."""
    return [
        [
            fibre.name,
            fibre.status,
            f"({number(fibre.start_m[0] * 1e3)}, {number(fibre.start_m[1] * 1e3)})",
            f"({number(fibre.end_m[0] * 1e3)}, {number(fibre.end_m[1] * 1e3)})",
            number(float(fibre.height_error_m) * 1e6),
            number(float(fibre.displacement_m) * 1e6),
            number(float(fibre.volume_m3) * 1e9),
        ]
        for fibre in found.fibres
    ]


def wavelength_rows(content: "ReportContent") -> list[list[str]]:
    """Wavelength [nm], mean light measured and re-simulated [W/m^2], relative residual [%], over what was measured."""
    counts = np.isfinite(content.measured) & np.isfinite(content.simulated)
    if content.mask is not None:
        counts &= content.mask
    rows = []
    for wavelength, measured, simulated, known in zip(
        content.scene.wavelengths_m, content.measured, content.simulated, counts, strict=False
    ):
        there, here = measured[known].astype(np.float64), simulated[known].astype(np.float64)
        light = float(np.linalg.norm(there)) if there.size else 0.0
        rest = 100 * float(np.linalg.norm(here - there)) / light if light > 0 else float("nan")
        rows.append([number(wavelength * 1e9, 4), _mean(there), _mean(here), number(rest)])
    return rows


def _mean(values: "FloatArray") -> str:
    return number(float(values.mean()), 4) if values.size else "n/a"


def scene_rows(scene: "Scene") -> list[tuple[str, str]]:
    """The set-up in words."""
    width, length = (size * 1e3 for size in scene.plate_size_m)
    x, y, z = (place * 1e3 for place in scene.screen_position_m)
    light = "collimated"
    if not scene.is_collimated:
        at = ", ".join(number(place * 1e3) for place in scene.light_position_m)
        light = f"point source at ({at}) mm, half-angle {number(np.degrees(scene.emission_half_angle_rad))} degrees"
    light += "".join(f", {name}" for name in _effects(scene))
    return [
        ("plate", f"{number(width)} x {number(length)} mm, {number(scene.base_thickness_m * 1e3)} mm thick"),
        ("height map", f"{scene.height_samples} x {scene.height_samples} samples"),
        ("caustic", f"{scene.image_pixels} x {scene.image_pixels} pixels"),
        ("wavelengths", ", ".join(number(value * 1e9, 4) for value in scene.wavelengths_m) + " nm"),
        ("screen", f"at z = {number(z)} mm" + (f", centre ({number(x)}, {number(y)}) mm" if x or y else "")),
        ("light", light),
        ("glass", str(scene.glass)),
        ("exit medium", str(scene.exit_medium)),
    ]


def _effects(scene: "Scene") -> list[str]:
    """What else is in the model, in words."""
    found = []
    if scene.is_tilted:
        found.append("tilted by ({}, {}) degrees".format(*(number(np.degrees(a)) for a in scene.light_tilt_rad)))
    if scene.lamp_half_angle_rad > 0:
        found.append(f"lamp of half-angle {number(np.degrees(scene.lamp_half_angle_rad))} degrees")
    if scene.lamp_radius_m > 0:
        found.append(f"lamp of radius {number(scene.lamp_radius_m * 1e3)} mm")
    if scene.fresnel:
        found.append("Fresnel's losses")
    if scene.second_hits != "ignored":
        found.append(f"second hits {scene.second_hits}")
    return found


def flat_rows(value: Any, prefix: str = "") -> list[tuple[str, str]]:
    """A nested record as names with dots and texts; long values are cut."""
    if isinstance(value, Mapping) and value:
        return [
            row for key, item in value.items() for row in flat_rows(item, f"{prefix}.{key}" if prefix else str(key))
        ]
    text = _setting(value)
    return [(prefix, text if len(text) <= MAX_TEXT else f"{text[:MAX_TEXT]}...")]


def _setting(value: Any) -> str:
    if isinstance(value, list) and not any(isinstance(item, list | Mapping) for item in value):
        return ", ".join(_setting(item) for item in value) or "none"
    if isinstance(value, float):
        return number(value, 4)
    if value is None:
        return "none"
    return value if isinstance(value, str) else json.dumps(value)


def file_rows(record: Mapping[str, Any]) -> list[list[str]]:
    """Role, path and sha256 of every input."""
    rows = []
    for role, file in mapping(record.get("inputs")).items():
        about = mapping(file)
        rows.append([role, str(about.get("path", file)), str(about.get("sha256", ""))])
    return rows


def record_groups(record: Mapping[str, Any]) -> list[tuple[str, list[tuple[str, str]]]]:
    """Everything else of a record that has a heading: settings, light, times, versions."""
    headings = (
        ("settings", "Settings"),
        ("counters", "Light and counters"),
        ("errors", "Errors against the reference"),
        ("uncertainty", "Uncertainty"),
        ("calibration", "Calibration"),
        ("timings_s", "Times [s]"),
        ("versions", "Versions"),
    )
    groups = [
        (heading, [row for row in flat_rows(record[key]) if (key, row[0]) != ("calibration", "steps")])
        for key, heading in headings
        if mapping(record.get(key))
    ]
    made = [(key, str(record[key])) for key in ("created", "config_fingerprint") if record.get(key)]
    return [("Made", made), *groups] if made else groups
