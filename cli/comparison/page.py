"""The page of a comparison: one file that opens anywhere, without a network."""

import base64
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from cli.comparison.curves import fold_scatter, iteration_curves
from cli.comparison.figures import MAX_COLUMNS, Sheets
from nets.evaluation.method_spec import CONVERGED, ONCE
from nets.evaluation.schedule import Setup
from nets.evaluation.table import MEASURES, Row, by_field, summary, summary_by_folds
from warp_caustics.io.atomic import write_text
from warp_caustics.io.page import page_file, render_page

_PACKAGE = "cli.comparison"


def write_page(
    path: Path, setup: Setup, records: Sequence[Mapping[str, Any]], rows: Sequence[Row], about: Mapping[str, Any]
) -> None:
    """Write the page.

    Args:
        path: of the page.
        setup: gives fields, scene, and the store of recovered reliefs.
        records: the cells.
        rows: the same as flat rows.
        about: what was compared.
    """
    budgets = list(about["iterations"])
    sheets = Sheets(list(setup.fields.values()), setup.scene, setup.device)
    folds = summary_by_folds(rows)
    text = render_page(
        _PACKAGE,
        "page.html.j2",
        own_style=page_file(_PACKAGE, "page.css"),
        script=page_file(_PACKAGE, "page.js"),
        column=column_name,
        about=about,
        measures=MEASURES,
        fields=list(setup.fields),
        summary=summary(rows),
        # With all fields in one bin it would say the summary again.
        by_folds=folds if len({row["fold_bin"] for row in folds}) > 1 else [],
        by_field=by_field(rows),
        rows=rows,
        failures=_failures(rows),
        warnings=_warnings(rows),
        truth=_inline(sheets.truth()),
        curves=_inline(iteration_curves(rows, budgets)),
        scatter=_inline(fold_scatter(rows, budgets)),
        sheets=[
            {"method": method, "budget": budget, "picture": _inline(_sheet(sheets, setup, records, method, budget))}
            for method, budget in shown_cells([row for row in rows if row["status"] == "done"], budgets)
        ],
        limit_um=sheets.limit_um,
        max_columns=MAX_COLUMNS,
    )
    write_text(path, text)


def shown_cells(rows: Sequence[Row], budgets: Sequence[str]) -> list[tuple[str, str]]:
    """Method and budget of every sheet: the first column, the last that counts, and the method's own stop."""
    counted = [budget for budget in budgets if budget != CONVERGED]
    wanted = {ONCE, *counted[:1], *counted[-1:], *(budget for budget in budgets if budget == CONVERGED)}
    pairs = dict.fromkeys((row["method"], row["budget"]) for row in rows)
    return [(method, budget) for method, budget in pairs if budget in wanted]


def column_name(budget: str) -> str:
    """A budget in words."""
    words = {CONVERGED: "own stop", ONCE: "-", "1": "1 iteration"}
    return words.get(budget, f"{budget} iterations")


def _sheet(sheets: Sheets, setup: Setup, records: Sequence[Mapping[str, Any]], method: str, budget: str) -> bytes:
    mine = [record for record in records if (record["method"], record["budget"]) == (method, budget)]
    done = {record["field"]: record for record in mine if record["status"] == "done"}
    heights = {name: setup.store.heights(record["key"]) for name, record in done.items()}
    return sheets.found(heights, {name: record["scores"]["rmse_um"] for name, record in done.items()})


def _failures(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Every reason of a failure once, with the fields and the stops it was met at."""
    found: dict[tuple[str, str], dict[str, dict[str, None]]] = {}
    for row in rows:
        if row["status"] == "failed":
            met = found.setdefault((row["method"], row["reason"]), {"fields": {}, "stops": {}})
            met["fields"][row["field"]] = None
            met["stops"][column_name(row["budget"])] = None
    return [
        {"method": method, "reason": reason} | {kind: list(names) for kind, names in met.items()}
        for (method, reason), met in found.items()
    ]


def _warnings(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Every warning of a method once, with the fields it was given for."""
    found: dict[tuple[str, str], dict[str, None]] = {}
    for row in rows:
        for warning in row["warnings"] or ():
            found.setdefault((row["method"], warning), {})[row["field"]] = None
    return [{"method": method, "text": text, "fields": list(names)} for (method, text), names in found.items()]


def _inline(picture: bytes) -> str:
    return "data:image/png;base64," + base64.b64encode(picture).decode("ascii")
