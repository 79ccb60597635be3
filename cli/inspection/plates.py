"""The table of inspected plates: one row per plate, on disk as soon as it is done, read again at the next start."""

import os
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cli.provenance import file_sha256
from warp_caustics.io.csv_table import CsvTable
from warp_caustics.io.printable import printable

PLATES = "plates.csv"
TREND = "trend.png"
RETRIED = (1, 6)
"""Exit codes that are no fault of the image: it is taken up again at the next start."""
COLUMNS = (
    "image", "modified", "status", "verdict", "exit_code", "peak_deviation_um", "worst_of_limit", "rms_deviation_um",
    "volume_mm3", "nominal_volume_mm3", "mass_g", "regions", "faulty_fibres", "residual", "seconds", "inspected",
    "folder", "reasons", "error", "sha256", "settings",
)  # fmt: skip


@dataclass(frozen=True)
class Stamp:
    """What tells a file from an earlier one of its name.

    Attributes:
        size: [bytes].
        modified: time of its last change, as in the table.
        mtime_ns: the same [ns].
        ctime_ns: time of the last change of content or name [ns], which nobody can set.
    """

    size: int
    modified: str
    mtime_ns: int
    ctime_ns: int


def stamp(path: str) -> Stamp:
    """Of a file.

    Raises:
        OSError: there is none.
    """
    info = os.stat(path)
    seconds, rest = divmod(info.st_mtime_ns, 1_000_000_000)
    text = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(seconds)) + f".{rest:09d}Z"
    return Stamp(info.st_size, text, info.st_mtime_ns, info.st_ctime_ns)


def listed_name(image: str) -> str:
    """Name of an image in the table."""
    return printable(os.path.basename(image))


def plate_row(image: str, record: Mapping[str, Any], seconds: float) -> dict[str, Any]:
    """The row of an inspected plate but for what its file tells.

    Args:
        image: path.
        record: of :func:`cli.inspection.files.inspection_record`, with ``residual``.
        seconds: how long it took [s].
    """
    faults = [fibre["name"] for fibre in record["fibres"] if fibre["status"] not in ("as designed", "hidden")]
    return {
        "image": listed_name(image),
        "status": "done",
        "verdict": record["verdict"],
        "peak_deviation_um": f"{record['peak_deviation_m'] * 1e6:.4g}",
        "worst_of_limit": "" if record["worst_of_limit"] is None else f"{record['worst_of_limit']:.4g}",
        "rms_deviation_um": f"{record['rms_deviation_m'] * 1e6:.4g}",
        "volume_mm3": f"{record['volume_m3'] * 1e9:.6g}",
        "nominal_volume_mm3": f"{record['nominal_volume_m3'] * 1e9:.6g}",
        "mass_g": f"{record['mass_kg'] * 1e3:.6g}",
        "regions": len(record["regions"]),
        "faulty_fibres": " ".join(faults),
        "residual": f"{record['residual']:.4g}",
        "seconds": f"{seconds:.1f}",
        "reasons": "; ".join(record["reasons"]),
    }


class Plates:
    """Rows of ``plates.csv``, the latest of each image.

    Args:
        folder: where it is or will be.
        settings: hash of all that a verdict depends on besides the image; rows of other settings are not skipped.
        content: hash of all that is read as an image, by its path.

    Raises:
        DamagedDataError: a table that is none.
    """

    def __init__(self, folder: Path, settings: str, content: Callable[[str], str] = file_sha256):
        self.settings, self._content = settings, content
        self._table = CsvTable(folder / PLATES, COLUMNS)
        self.rows: list[dict[str, Any]] = []
        if self._table.path.exists():
            self.rows = [dict(row) for row in self._table.read(is_exact=True)]

    @property
    def table(self) -> CsvTable:
        """On disk."""
        return self._table

    def row_of(self, image: str) -> dict[str, Any] | None:
        """The row of an image of that name with the present settings."""
        name = listed_name(image)
        found = [row for row in self.rows if row["image"] == name and row["settings"] == self.settings]
        return found[-1] if found else None

    def is_done(self, image: str) -> bool:
        """Whether this very image was inspected with these settings: its content decides, since times can be copied."""
        row = self.row_of(image)
        if row is None or int(row["exit_code"]) in RETRIED:
            return False
        return bool(row["sha256"]) and row["sha256"] == self._content(image)

    def add(self, image: str, row: Mapping[str, Any]) -> None:
        """Append a row, in place of an earlier one of that image; on disk when this returns."""
        complete = {**row, "settings": self.settings, "inspected": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())}
        name = listed_name(image)
        self.rows = [old for old in self.rows if old["image"] != name] + [complete]
        self._table.write(self.rows)
