"""A result in one line, and its key figures."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from cli.report.number import number

if TYPE_CHECKING:
    from cli.report.content import ReportContent

VERDICTS = {"pass": ("\u2713", "Pass"), "fail": ("\u2715", "Fail"), "uncertain": ("?", "Uncertain")}
"""Sign and word of each verdict, for those who cannot tell its colour."""


@dataclass(frozen=True)
class KeyFigure:
    """One number worth knowing.

    Attributes:
        label: what it is.
        value: the number.
        unit: empty where it has none.
        note: a few more words.
    """

    label: str
    value: str
    unit: str = ""
    note: str = ""


def mapping(value: Any) -> Mapping[str, Any]:
    """A part of a record; empty where it is missing."""
    return value if isinstance(value, Mapping) else {}


def headline(content: "ReportContent", record: Mapping[str, Any]) -> str:
    """What came out, in one line."""
    found = content.inspection
    if found is not None and found.reasons:
        return "; ".join(found.reasons)
    low, high = relief_range_um(content)
    parts = [f"Relief from {number(low)} to {number(high)} um"]
    if record.get("method"):
        parts[0] += f", recovered by {record['method']}"
    if (seconds := _seconds(record)) is not None:
        parts[0] += f" in {number(seconds)} s"
    if record.get("residual") is not None:
        at = f", at all {content.scene.image_pixels} pixels" if _judged_pixels(record) else ""
        parts.append(f"its caustic differs from the image by {number(_percent(record['residual']))} %{at}")
    if mapping(record.get("errors")).get("rmse_um") is not None:
        parts.append(f"RMSE against the reference {number(record['errors']['rmse_um'])} um")
    return "; ".join(parts) + "."


def trust_line(record: Mapping[str, Any]) -> str:
    """How far the result is to be believed, as a sentence; empty where nothing tells."""
    line = str(mapping(record.get("trust")).get("line") or "")
    return f"{line[0].upper()}{line[1:]}." if line else ""


def rest_line(record: Mapping[str, Any]) -> str:
    """What the rest of the image looks like, as a sentence; empty where nothing tells."""
    line = str(mapping(mapping(record.get("counters")).get("rest")).get("line") or "")
    return f"Left: {line}." if line else ""


def care_line(record: Mapping[str, Any]) -> str:
    """How much less well the bench is taken as known than of a careful user, as a sentence; empty where hardly so."""
    of_bench = mapping(mapping(mapping(record.get("counters")).get("uncertainty")).get("care"))
    line = str(of_bench.get("line") or "")
    return f"{line[0].upper()}{line[1:]}." if line else ""


def samples_line(record: Mapping[str, Any]) -> str:
    """How far samples of what the image leaves open lie apart, as a sentence; empty where none were asked for."""
    line = str(mapping(mapping(record.get("counters")).get("samples")).get("line") or "")
    return f"Samples {line}." if line else ""


def no_uncertainty(record: Mapping[str, Any]) -> str:
    """Why the result has no uncertainty, as a sentence; empty where it has one."""
    why = str(record.get("no_uncertainty") or "")
    return f"Standard uncertainty: none, because {why}." if why else ""


def _judged_pixels(record: Mapping[str, Any]) -> int | None:
    """Pixels per side at which the line of trust judges; None for all of them."""
    pixels = mapping(record.get("trust")).get("pixels")
    return pixels if isinstance(pixels, int) else None


def key_figures(content: "ReportContent", record: Mapping[str, Any]) -> list[KeyFigure]:
    """The numbers at the top of the page."""
    figures = _inspection_figures(content) if content.inspection else []
    low, high = relief_range_um(content)
    figures.append(KeyFigure("Highest point", number(high), "um", f"lowest {number(low)} um"))
    if content.inspection is None:
        figures.append(KeyFigure("Printed volume", number(volume_mm3(content)), "mm\u00b3", "above the plate's base"))
    if record.get("residual") is not None:
        note = "of the light, between image and re-simulation"
        if pixels := _judged_pixels(record):
            note += f", at all {content.scene.image_pixels} pixels; the line above judges at {pixels}"
            floor = mapping(record.get("trust")).get("floor_at_all")
            if isinstance(floor, float):
                note += f"; noise and simulation leave {number(_percent(floor))} % of all"
        figures.append(KeyFigure("Image residual", number(_percent(record["residual"])), "%", note))
    errors = mapping(record.get("errors"))
    if errors.get("rmse_um") is not None:
        within, flat = number(errors.get("quantile95_um")), number(errors.get("reference_rms_um"))
        note = f"95 % within {within} um; flat guess {flat} um"
        figures.append(KeyFigure("RMSE to reference", number(errors["rmse_um"]), "um", note))
    if content.uncertainty_m is not None:
        sigma = content.uncertainty_m[np.isfinite(content.uncertainty_m)] * 1e6
        if sigma.size:
            note = f"95 % of the plate below {number(float(np.quantile(sigma, 0.95)))} um"
            root = number(float(np.sqrt(np.mean(sigma**2))))
            figures.append(KeyFigure("Standard uncertainty", root, "um", f"root mean square; {note}"))
    if record.get("method"):
        steps = f"{record['iterations']} iterations" if record.get("iterations") else ""
        why = str(record.get("stop_reason") or "").replace("_", " ")
        note = ", ".join(part for part in (steps, f"stopped by {why}" if why else "") if part)
        figures.append(KeyFigure("Method", str(record["method"]), "", note))
    if (seconds := _seconds(record)) is not None:
        figures.append(KeyFigure("Computing time", number(seconds), "s"))
    return figures


def _inspection_figures(content: "ReportContent") -> list[KeyFigure]:
    found = content.inspection
    assert found is not None
    judged = np.asarray(found.mask, dtype=bool)
    beyond = float(np.asarray(found.out_of_tolerance, dtype=bool)[judged].mean()) if judged.any() else float("nan")
    deviation = found.deviation_m[judged & np.isfinite(found.deviation_m)]
    largest = float(deviation[np.argmax(np.abs(deviation))]) if deviation.size else float("nan")
    nominal = f"design {number(found.nominal_volume_m3 * 1e9)} mm\u00b3"
    if found.nominal_volume_m3 > 0:
        share = 100 * (found.volume_m3 / found.nominal_volume_m3 - 1)
        nominal += f" ({'+' if share > 0 else ''}{number(share, 2)} %)"
    count = f"{len(found.regions)} region{'' if len(found.regions) == 1 else 's'}"
    steepest = ""
    if found.limit_m is not None and np.isfinite(found.limit_m).any():
        steepest = f"along the normal; vertically up to {number(float(np.nanmax(found.limit_m)) * 1e6)} um on flanks"
    undecided = []
    if found.undecided is not None and judged.any():
        unknown = number(100 * float(found.undecided[judged].mean()))
        undecided = [KeyFigure("Undecided", unknown, "%", "of the judged area: the measurement cannot tell")]
    return [
        KeyFigure("Tolerance", f"\u00b1{number(found.tolerance_m * 1e6)}", "um", steepest),
        KeyFigure("Out of tolerance", number(100 * beyond), "%", f"of the judged area, {count}"),
        *undecided,
        KeyFigure("Largest deviation", _signed(largest * 1e6), "um", "measured minus design"),
        KeyFigure("Printed volume", number(found.volume_m3 * 1e9), "mm\u00b3", nominal),
        KeyFigure("Printed mass", number(found.mass_kg * 1e6), "mg"),
    ]


def coverage(record: Mapping[str, Any]) -> str:
    """What share of the errors the uncertainty covers; empty where the truth is not known."""
    found = mapping(record.get("uncertainty"))
    if found.get("within_one") is None or found.get("within_two") is None:
        return ""
    one, two = (number(_percent(found[key])) for key in ("within_one", "within_two"))
    return (
        f"Of the plate, {one} % lies within one and {two} % within two standard uncertainties of the reference "
        "(68 % and 95 % if errors were normal)."
    )


def relief_range_um(content: "ReportContent") -> tuple[float, float]:
    """Lowest and highest finite height [um]; NaN where there is none."""
    heights = content.heights_m[np.isfinite(content.heights_m)] * 1e6
    return (float(heights.min()), float(heights.max())) if heights.size else (float("nan"), float("nan"))


def volume_mm3(content: "ReportContent") -> float:
    """Volume of the relief above the base [mm^3]: mean height times the plate's area."""
    heights = content.heights_m[np.isfinite(content.heights_m)]
    return float(heights.mean()) * content.scene.plate_area_m2 * 1e9 if heights.size else float("nan")


def _signed(value: float) -> str:
    return f"+{number(value)}" if value > 0 else number(value)


def _percent(part: Any) -> float:
    return 100 * float(part)


def _seconds(record: Mapping[str, Any]) -> float | None:
    times = [value for value in mapping(record.get("timings_s")).values() if isinstance(value, int | float)]
    return float(sum(times)) if times else None
