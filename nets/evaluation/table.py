"""Cells as rows, and what they say together."""

import csv
import io
import statistics
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from nets.evaluation.fields import Field
from nets.evaluation.scores import SCORES
from warp_caustics.fold_fraction import fold_bin, fold_bins
from warp_caustics.io.atomic import write_text
from warp_caustics.io.csv_table import escaped
from warp_caustics.io.json_file import write_json

COSTS = {"time_s": "time [s]", "peak_memory_MB": "peak memory [MB]"}

MEASURES = SCORES | COSTS
"""Every number of a row, and what it is."""

COLUMNS = (
    "field", "fold_fraction", "fold_bin", "method", "budget", "status", "iterations", *MEASURES,
    "stop_reason", "privileged", "warnings", "reason", "device", "key",
)  # fmt: skip

Row = dict[str, Any]


def table_rows(records: Sequence[Mapping[str, Any]], fields: Mapping[str, Field]) -> list[Row]:
    """One flat row per cell, with :data:`COLUMNS`; None where a failed cell has no value."""
    rows = []
    for record in records:
        folds = fields[record["field"]].folds
        scores = record.get("scores", {})
        row = {name: record.get(name, scores.get(name)) for name in COLUMNS}
        row |= {"fold_fraction": folds, "fold_bin": fold_bin(folds)}
        rows.append(row)
    return rows


def summary(rows: Sequence[Row]) -> list[Row]:
    """Mean and median of every measure over the fields, per method and budget."""
    return _grouped(rows, ("method", "budget"))


def summary_by_folds(rows: Sequence[Row]) -> list[Row]:
    """The same within each bin of fold fractions that holds a field, few folds first."""
    order = fold_bins()
    return sorted(_grouped(rows, ("fold_bin", "method", "budget")), key=lambda row: order.index(row["fold_bin"]))


def by_field(rows: Sequence[Row], measure: str = "rmse_um") -> list[Row]:
    """One row per method and budget, one column per field."""
    found: dict[tuple[str, str], Row] = {}
    for row in rows:
        line = found.setdefault((row["method"], row["budget"]), {"method": row["method"], "budget": row["budget"]})
        line[row["field"]] = row[measure]
    return list(found.values())


def write_tables(folder: Path, rows: Sequence[Row], about: Mapping[str, Any]) -> None:
    """Write ``table.csv``, ``summary.csv`` and ``table.json``.

    Args:
        folder: where.
        rows: the cells.
        about: what was compared, for the JSON file.
    """
    grouped = summary(rows)
    folds = summary_by_folds(rows)
    record = {"about": about, "rows": rows, "summary": grouped, "by_folds": folds, "by_field": by_field(rows)}
    write_text(folder / "table.csv", _csv_text(rows, COLUMNS))
    write_text(folder / "summary.csv", _csv_text([*grouped, *folds], ("fold_bin", *grouped[0])))
    write_json(folder / "table.json", record)


def _grouped(rows: Iterable[Row], keys: Sequence[str]) -> list[Row]:
    groups: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault(tuple(row[key] for key in keys), []).append(row)
    found = []
    for values, members in groups.items():
        done = [member for member in members if member["status"] == "done"]
        line: Row = dict(zip(keys, values, strict=True)) | {"fields": len(members), "done": len(done)}
        privileged = sorted({name for member in done for name in member["privileged"]})
        for measure in MEASURES:
            known = [float(member[measure]) for member in done if member[measure] is not None]
            line[f"{measure}_mean"] = _of(statistics.fmean, known)
            line[f"{measure}_median"] = _of(statistics.median, known)
        found.append(line | {"privileged": privileged})
    return found


def _of(statistic: Callable[[list[float]], float], values: list[float]) -> float | None:
    return statistic(values) if values else None


def _csv_text(rows: Sequence[Row], columns: Sequence[str]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, restval="all", lineterminator="\n")
    writer.writeheader()
    for row in rows:
        writer.writerow({name: _cell_text(value) for name, value in row.items()})
    return text.getvalue()


def _cell_text(value: Any) -> Any:
    return escaped("; ".join(map(str, value)) if isinstance(value, list | tuple) else value)
