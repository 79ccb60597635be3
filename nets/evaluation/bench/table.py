"""Records of a run as rows, and what they say together."""

import statistics
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from nets.evaluation.bench.scores import BENCH_SCORES

Row = dict[str, Any]

COLUMNS = (
    "case",
    "row",
    "title",
    "method",
    "status",
    *BENCH_SCORES,
    "warned",
    "explained",
    "doubted",
    "trust",
    "time_s",
    "warnings",
    "reason",
)
"""Of a row."""


def bench_rows(records: Iterable[Mapping[str, Any]]) -> list[Row]:
    """One flat row per case and method; None where a failed one has no value."""
    rows = []
    for record in records:
        scores = record.get("scores", {})
        row = {name: record.get(name, scores.get(name)) for name in COLUMNS}
        rows.append(row | {"case": record["field"]})
    return rows


def bench_summary(rows: Sequence[Row]) -> list[Row]:
    """Per row of the suite and method: means over its plates, the median error, how many warned, explained, doubted.

    Shares within one and two are means over plates whose result has an uncertainty, and which have of the region; None
    if there is none.
    """
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row["row"], row["method"]), []).append(row)
    found = []
    for (name, method), members in groups.items():
        done = [row for row in members if row["status"] == "done"]
        line: Row = {"row": name, "title": members[0]["title"], "method": method, "plates": len(members)}
        line["done"] = len(done)
        for score in (*BENCH_SCORES, "time_s"):
            known = [float(row[score]) for row in done if row[score] is not None]
            line[score] = statistics.fmean(known) if known else None
        errors = [float(row["rmse_um"]) for row in done]
        line["rmse_um_median"] = statistics.median(errors) if errors else None
        for which in ("warned", "explained", "doubted"):
            told = [row[which] for row in done if row[which] is not None]
            line[which] = sum(told) if told else None
        found.append(line)
    return found
