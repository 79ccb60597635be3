"""The page of a run: one file that opens anywhere, without a network."""

import base64
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from nets.evaluation.bench.coverage import REGIONS, SHORT, WITHIN
from nets.evaluation.bench.detector import detection
from nets.evaluation.bench.scores import BENCH_SCORES, SHORT_SCORES
from nets.evaluation.bench.table import Row, bench_summary
from warp_caustics.io.atomic import write_text
from warp_caustics.io.page import page_file, render_page

_PACKAGE = "cli.bench_report"


def write_bench_page(
    path: Path, rows: Sequence[Row], about: Mapping[str, Any], pictures: Iterable[tuple[str, str, bytes]] | None
) -> None:
    """Write the page.

    Args:
        path: of the page.
        rows: one per case and method.
        about: what was run.
        pictures: name, title and PNG of each row of the suite; None leaves them out.
    """
    text = render_page(
        _PACKAGE,
        "page.html.j2",
        own_style=page_file("cli.comparison", "page.css"),
        script=page_file("cli.comparison", "page.js"),
        about=about,
        scores=SHORT_SCORES,
        meanings=BENCH_SCORES,
        regions=SHORT,
        region_meanings=REGIONS,
        within=WITHIN,
        detection=detection(rows),
        summary=bench_summary(rows),
        rows=rows,
        failures=_failures(rows),
        pictures=[
            {"row": row, "title": title, "picture": "data:image/png;base64," + base64.b64encode(png).decode("ascii")}
            for row, title, png in pictures or ()
        ],
    )
    write_text(path, text)


def _failures(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Every reason of a failure once, with the cases it was met at."""
    found: dict[tuple[str, str], list[str]] = {}
    for row in rows:
        if row["status"] == "failed":
            found.setdefault((row["method"], row["reason"]), []).append(row["case"])
    return [{"method": method, "reason": reason, "cases": cases} for (method, reason), cases in found.items()]
