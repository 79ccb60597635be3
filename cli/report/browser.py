"""What the page's script draws, as one record for JSON."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from cli.report.arrays import MAP_SAMPLES, SURFACE_SAMPLES, finite_range, packed, reduced
from cli.report.colours import colour_scale
from cli.report.maps import Map
from cli.report.number import number

if TYPE_CHECKING:
    from cli.report.content import ReportContent
    from warp_caustics.types import FloatArray

_BINS = 81
_SURFACE_PART = 0.22
"""Height of an exaggerated relief as part of the plate's longer side."""


def browser_record(content: "ReportContent", maps: Mapping[str, Map], record: Mapping[str, Any]) -> dict[str, Any]:
    """Arrays, scales and marks.

    Args:
        content: the result.
        maps: what is drawn as a map, by name.
        record: ``content.record`` in types that JSON knows.
    """
    width, length = (size * 1e3 for size in content.scene.plate_size_m)
    profiles = {
        "recovered": content.heights_m,
        "design": content.inspection.nominal_m if content.inspection else None,
        "reference": content.reference_m,
    }
    low, high = finite_range(*profiles.values())
    return {
        "plate_mm": [width, length],
        "maps": {name: _map(shown) for name, shown in maps.items()},
        "profiles": {
            name: packed(reduced(values * 1e6, MAP_SAMPLES)) for name, values in profiles.items() if values is not None
        },
        "profile_range_um": [low * 1e6, high * 1e6],
        "sigma": None if content.uncertainty_m is None else packed(reduced(content.uncertainty_m * 1e6, MAP_SAMPLES)),
        "start": _highest(reduced(content.heights_m, MAP_SAMPLES)),
        "surface": _surface(content, maps, width, length),
        "histograms": {name: _histogram(shown) for name, shown in maps.items()},
        "convergence": _convergence(record),
    }


def _map(shown: Map) -> dict[str, Any]:
    values = reduced(shown.values, MAP_SAMPLES)
    return {
        "values": packed(values),
        "title": shown.title,
        "label": shown.label,
        "unit": shown.unit,
        "colours": colour_scale(shown.colours),
        "low": shown.low,
        "high": shown.high,
        "is_log": shown.is_log,
        "ticks": _ticks(shown),
        "boxes": list(shown.boxes_mm),
    }


def _surface(content: "ReportContent", maps: Mapping[str, Map], width: float, length: float) -> dict[str, Any]:
    heights = reduced(content.heights_m * 1e6, SURFACE_SAMPLES)
    low, high = finite_range(heights)
    colours = [name for name in ("deviation", "height", "error") if name in maps]
    relief_mm = (high - low) * 1e-3
    return {
        "heights": packed(heights),
        "range_um": [low, high],
        "factor": _round_down(_SURFACE_PART * max(width, length) / relief_mm),
        "colours": {name: packed(reduced(maps[name].values, SURFACE_SAMPLES)) for name in colours},
    }


def _highest(heights: "FloatArray") -> list[int]:
    """Row and column of the highest point, or of the middle."""
    if not np.isfinite(heights).any():
        return [heights.shape[0] // 2, heights.shape[1] // 2]
    row, column = np.unravel_index(int(np.nanargmax(heights)), heights.shape)
    return [int(row), int(column)]


def _histogram(shown: Map) -> dict[str, Any]:
    """Share of the values [%] per bin between the ends of the colour scale; what is beyond counts in the last bins."""
    values = shown.values[np.isfinite(shown.values)]
    low, high = shown.low, shown.high
    edges = np.linspace(low, high, _BINS + 1)
    counts, _ = np.histogram(np.clip(values, low, high), edges)
    return {
        "centres": ((edges[1:] + edges[:-1]) / 2).tolist(),
        "share": (100 * counts / max(1, values.size)).tolist(),
        "width": float(edges[1] - edges[0]),
        "label": shown.label,
        "ticks": _ticks(shown),
        "tolerance": shown.tolerance,
        "is_cut": bool(values.size and (values.max() > high or values.min() < low)),
    }


def _ticks(shown: Map) -> list[tuple[float, str]] | None:
    """Place and text on a logarithmic scale, which Plotly takes for a linear one."""
    return [(place, number(10**place)) for place in shown.log_ticks] if shown.is_log else None


def _convergence(record: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Residual [%] per iteration, one curve per stage."""
    curves: dict[str, dict[str, Any]] = {}
    for index, entry in enumerate(record.get("history") or (), 1):
        residual = entry.get("residual") if isinstance(entry, Mapping) else None
        if not isinstance(residual, int | float) or residual <= 0:
            continue
        stage = str(entry.get("stage") or "iterations")
        curve = curves.setdefault(stage, {"stage": stage, "iteration": [], "residual": []})
        curve["iteration"].append(index)
        curve["residual"].append(100 * float(residual))
    return list(curves.values())


def _round_down(factor: float) -> float:
    """The next lower of 1, 2, 5 times a power of ten; at least 1."""
    if factor <= 1:
        return 1.0
    power = 10.0 ** np.floor(np.log10(factor))
    return float(max(step * power for step in (1, 2, 5) if step * power <= factor * (1 + 1e-9)))
