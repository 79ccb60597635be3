"""What an inspection writes besides the result of its reconstruction."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cli.output import ResultKind
from cli.results import ALL_FILES
from warp_caustics.io.csv_table import CsvTable
from warp_caustics.io.json_file import write_json

if TYPE_CHECKING:
    from warp_caustics.inspection.findings import Inspection
    from warp_caustics.inspection.place import Place
    from warp_caustics.scene import Scene

OWN_FILES = (
    "inspection.json", "inspection.png", "deviation.npy", "deviation.tif", "regions.csv", "fibres.csv",
)  # fmt: skip
INSPECTION_FILES = (*ALL_FILES, *OWN_FILES)
"""What the folder of an inspected plate may hold."""
INSPECTION = ResultKind("inspection", INSPECTION_FILES)

_REGION_COLUMNS = (
    "number", "x_mm", "y_mm", "lower_x_mm", "lower_y_mm", "upper_x_mm", "upper_y_mm", "area_mm2", "volume_mm3",
    "peak_um",
)  # fmt: skip
_FIBRE_COLUMNS = (
    "name", "status", "start_x_mm", "start_y_mm", "end_x_mm", "end_y_mm", "height_error_um", "displacement_um",
    "volume_mm3", "width_error_um",
)  # fmt: skip


def inspection_record(found: "Inspection") -> dict[str, Any]:
    """Everything about an inspection but its arrays."""
    deviation = found.deviation_m[found.mask]
    return {
        "verdict": found.verdict,
        "reasons": found.reasons,
        "tolerance_m": found.tolerance_m,
        "rms_deviation_m": float(np.sqrt(np.mean(deviation**2))),
        "peak_deviation_m": float(deviation[np.argmax(np.abs(deviation))]),
        "worst_of_limit": None
        if found.limit_m is None
        else float((np.abs(deviation) / found.limit_m[found.mask]).max()),
        "judged_fraction": float(found.mask.mean()),
        "out_fraction": float(found.out_of_tolerance.sum() / found.mask.sum()),
        "undecided_fraction": None if found.undecided is None else float(found.undecided.sum() / found.mask.sum()),
        "volume_m3": found.volume_m3,
        "nominal_volume_m3": found.nominal_volume_m3,
        "mass_kg": found.mass_kg,
        "regions": [vars(region) for region in found.regions],
        "fibres": [vars(fibre) for fibre in found.fibres],
        "place": None if found.place is None else place_record(found.place),
        "warnings": found.warnings,
    }


def place_record(place: "Place") -> dict[str, Any]:
    """Where the whole picture lies, with standard uncertainties in the order of shift, turn, size and gain."""
    return {
        "shift_m": place.shift_m,
        "turn_rad": place.turn_rad,
        "size": place.size,
        "gain": place.gain,
        "sigma": place.sigma,
    }


def write_inspection(folder: Path, found: "Inspection", scene: "Scene", title: str, record: Mapping[str, Any]) -> None:
    """Write ``OWN_FILES`` into a folder.

    Args:
        folder: exists.
        found: the inspection.
        scene: gives the plate's size.
        title: of the plate.
        record: what goes to inspection.json.
    """
    from cli.figures import write_figure
    from cli.inspection.figure import inspection_figure
    from warp_caustics.io.heights import write_heights

    write_heights(folder / "deviation.npy", found.deviation_m)
    write_heights(folder / "deviation.tif", found.deviation_m)
    write_figure(folder / "inspection.png", inspection_figure(found, scene, title))
    CsvTable(folder / "regions.csv", _REGION_COLUMNS).write([_region_row(region) for region in found.regions])
    CsvTable(folder / "fibres.csv", _FIBRE_COLUMNS).write([_fibre_row(fibre) for fibre in found.fibres])
    write_json(folder / "inspection.json", record)


def _region_row(region: Any) -> dict[str, Any]:
    return {
        "number": region.number,
        "x_mm": _rounded(region.centre_m[0] * 1e3),
        "y_mm": _rounded(region.centre_m[1] * 1e3),
        "lower_x_mm": _rounded(region.lower_m[0] * 1e3),
        "lower_y_mm": _rounded(region.lower_m[1] * 1e3),
        "upper_x_mm": _rounded(region.upper_m[0] * 1e3),
        "upper_y_mm": _rounded(region.upper_m[1] * 1e3),
        "area_mm2": _rounded(region.area_m2 * 1e6),
        "volume_mm3": _rounded(region.volume_m3 * 1e9),
        "peak_um": _rounded(region.peak_m * 1e6),
    }


def _fibre_row(fibre: Any) -> dict[str, Any]:
    return {
        "name": fibre.name,
        "status": fibre.status,
        "start_x_mm": _rounded(fibre.start_m[0] * 1e3),
        "start_y_mm": _rounded(fibre.start_m[1] * 1e3),
        "end_x_mm": _rounded(fibre.end_m[0] * 1e3),
        "end_y_mm": _rounded(fibre.end_m[1] * 1e3),
        "height_error_um": _rounded(fibre.height_error_m * 1e6),
        "displacement_um": _rounded(fibre.displacement_m * 1e6),
        "volume_mm3": _rounded(fibre.volume_m3 * 1e9),
        "width_error_um": _rounded(fibre.width_error_m * 1e6),
    }


def _rounded(value: float) -> str:
    """Six significant figures; empty where it is not known."""
    return f"{value:.6g}" if math.isfinite(value) else ""
