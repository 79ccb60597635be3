"""Numbers of benches that methods found, against those that the benches of a suite have."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from data_gen.suites.case import Case
from warp_caustics.found_bench.bench_numbers import AMBIENT, VERGENCE
from warp_caustics.found_bench.bench_record import NOT_TOLD
from warp_caustics.materials import REFERENCE_WAVELENGTH_M, melt_index, refractive_index
from warp_caustics.setup.optical import optical_values
from warp_caustics.way_of_light import way_of_light_m

Row = dict[str, Any]


def true_numbers(case: Case) -> dict[str, float]:
    """Numbers that a reconstruction may find, as the bench of a case has them, by name.

    A picture that is moved by the camera is one of a screen that was moved the other way; one that is M too large is
    that of a vergence M / D. Where channels are moved or scaled apart, the picture is where the middle one is.
    """
    scene, told, condition = case.scene, case.told, case.condition
    values = optical_values(scene, told) | {AMBIENT: condition.ambient}
    if scene.glass != told.glass:
        values["index_offset"] = melt_index(scene.glass, REFERENCE_WAVELENGTH_M, scene.index_offset) - refractive_index(
            told.glass, REFERENCE_WAVELENGTH_M
        )
        values["dispersion_scale"] = float(np.ptp(scene.glass_indices) / np.ptp(told.glass_indices))
    if case.camera is not None:
        values[AMBIENT] = float(np.mean(case.camera.ambient))
        for name, moved, size in zip(
            ("screen_x_m", "screen_y_m"), case.camera.shift_px, scene.pixel_size_m, strict=True
        ):
            values[name] -= moved * size
    if condition.scaled and VERGENCE in values:
        values[VERGENCE] += condition.scaled[len(condition.scaled) // 2] / way_of_light_m(told)
    return values


def number_rows(cases: Iterable[Case], records: Iterable[Mapping[str, Any]]) -> list[Row]:
    """A row for each number that an image told: told, true and found, its standard deviation, and the verdict.

    Args:
        cases: of a suite.
        records: of cells, of these and other cases.
    """
    true = {case.name: true_numbers(case) for case in cases}
    rows = []
    for record in records:
        found = record.get("counters", {}).get("bench", {}).get("numbers", [])
        for number in found if record["field"] in true else []:
            if number["verdict"] == NOT_TOLD:
                continue
            kept = {key: number[key] for key in ("name", "unit", "told", "found", "sigma", "verdict")}
            about = {key: record[key] for key in ("row", "method")}
            rows.append({"case": record["field"], **about, **kept, "true": true[record["field"]][number["name"]]})
    return rows


def covered_numbers(rows: Sequence[Mapping[str, Any]]) -> tuple[float, float] | None:
    """Shares of numbers within one and two standard deviations of the truth; None of none."""
    if not rows:
        return None
    off = np.array([abs(row["found"] - row["true"]) / row["sigma"] if row["sigma"] else np.inf for row in rows])
    return float((off <= 1).mean()), float((off <= 2).mean())
