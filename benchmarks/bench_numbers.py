"""What stored results of the test bench say of their benches, against what these are: a table of docs/bench.md."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from nets.evaluation.bench.found_numbers import covered_numbers

UNITS: dict[tuple[str, ...], tuple[str, str, float]] = {
    ("gap_m",): ("gap", "um", 1e6),
    ("base_thickness_m",): ("base", "um", 1e6),
    ("index_offset",): ("index", "0.0001", 1e4),
    ("dispersion_scale",): ("dispersion", "%", 1e2),
    ("screen_x_m", "screen_y_m"): ("shift of the picture", "um", 1e6),
    ("tilt_x_rad", "tilt_y_rad"): ("tilt of the light", "mrad", 1e3),
    ("vergence_per_m",): ("vergence", "/m", 1.0),
    ("lamp_distance_m",): ("distance of the lamp", "mm", 1e3),
    ("ambient",): ("stray light", "%", 1e2),
}
"""Names that are one line of the table, what people call them, and the unit in which they are told."""
KEPT = ("name", "told", "true", "found", "sigma")
"""Of a number."""


def numbers_of(rows: Sequence[Mapping[str, Any]]) -> dict[str, list[Any]]:
    """What is stored of the numbers of a row's plates: lists as long as there are numbers, by :data:`KEPT`."""
    return {key: [float(f"{row[key]:.4g}") if key == "sigma" else row[key] for row in rows] for key in KEPT}


def numbers_table(suites: Mapping[str, Mapping[str, Any]], method: str) -> list[str]:
    """Lines of the table in Markdown: how far off numbers are that images told, and how much of that is stated.

    Of numbers that are as told those that were found so, which is no error at all, are counted as well.
    """
    known = [number for suite in suites.values() for row in suite.get(method, {}).values() for number in _each(row)]
    head = ["number", "unit"]
    for which in ("other than told", "as told"):
        head += [which, "off, median", "stated, median", "within 1, 2"]
    lines = [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
    for names, (title, unit, factor) in UNITS.items():
        own = [number for number in known if number["name"] in names]
        cells = [title, unit]
        for is_other in (True, False):
            cells += _cells([number for number in own if _is_other(number) == is_other], factor)
        if own:
            lines.append(f"| {' | '.join(cells)} |")
    return lines


def _each(row: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Stored numbers of a row; rows that were stored before have none."""
    stored = row.get("numbers", {})
    return [dict(zip(KEPT, values, strict=True)) for values in zip(*(stored.get(key, ()) for key in KEPT), strict=True)]


def _is_other(number: Mapping[str, Any]) -> bool:
    return not np.isclose(number["true"], number["told"], rtol=1e-6, atol=1e-9)


def _cells(numbers: Sequence[Mapping[str, Any]], factor: float) -> list[str]:
    """How many, their median error and deviation, and the shares within one and two."""
    covered = covered_numbers(numbers)
    if covered is None:
        return ["0", "", "", ""]
    off = [abs(number["found"] - number["true"]) for number in numbers]
    median, stated = (factor * float(np.median(values)) for values in (off, [number["sigma"] for number in numbers]))
    return [str(len(numbers)), f"{median:.2g}", f"{stated:.2g}", f"{100 * covered[0]:.0f}, {100 * covered[1]:.0f} %"]
