"""The stored figures of ``nsfc bench``, and the tables of docs/bench.md made from them.

    python -m benchmarks.bench RUN/table.json ...   # figures of runs into benchmarks/bench.json, tables anew
    python -m benchmarks.bench                      # the tables anew, from the stored figures

``make bench-lab`` runs all suites and then this. Of each suite, method and row the file holds the figures of every
plate, and on what and with which networks they were computed. A row of a run replaces the stored row, unless that has
more plates; rows of earlier networks have a star in the tables.
"""

import json
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.bench_numbers import numbers_of, numbers_table
from benchmarks.bench_trust import trust_table
from benchmarks.of_weights import shipped
from data_gen.suites.suites import SUITES, suite_cases
from nets.evaluation.bench.coverage import COVERAGE, WITHIN

FILE = Path(__file__).with_name("bench.json")
PAGE = Path(__file__).parents[1] / "docs" / "bench.md"

FIGURES = (
    "rmse_um",
    "rmse_aligned_um",
    "rmse_form_removed_um",
    "slope_error",
    "stated_um",
    *COVERAGE,
    "flat_um",
    "warned",
    "explained",
    "doubted",
    "time_s",
)
"""Of each plate."""
SINCE = ("rmse_form_removed_um", "stated_um", "doubted", *(name for name in COVERAGE if name not in WITHIN))
"""Of these, what rows have that were stored since it is counted."""
ON_RELIEF = "within_one_on_relief"
MEASURED_WITH = ("direct", "direct-family")
"""Networks whose hash is stored: those of the methods that the tables show."""


TRUSTED = "fibres"
"""Method of the tables of what is stated."""
WITH_NETWORKS = ("direct", "fibres")
"""Methods whose figures are theirs; of a row that was measured with earlier ones a star tells."""


def stored() -> dict[str, Any]:
    """What is in the file; empty where there is none."""
    if not FILE.exists():
        return {"suites": {}}
    tree: dict[str, Any] = json.loads(FILE.read_text(encoding="utf-8"))
    return tree


def collect(tree: dict[str, Any], run: Mapping[str, Any], weights: Mapping[str, str]) -> None:
    """Take the figures of a run over into a tree.

    Args:
        tree: as stored; changed.
        run: ``table.json`` of ``nsfc bench run``.
        weights: hash of each network of :data:`MEASURED_WITH`.

    Raises:
        SystemExit: a run of other plates or another number of light paths than the suite's, or without a device.
    """
    about = run["about"]
    if about["n_photons"] is not None or about.get("seed") is not None or about["device"] is None:
        raise SystemExit(
            f"suite {about['suite']}: figures of --n-photons or --seed, or of heights that were given, are not stored"
        )
    suite = tree["suites"].setdefault(about["suite"], {})
    rows: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for row in run["rows"]:
        rows.setdefault((row["method"], row["row"]), []).append(row)
    for (method, name), found in rows.items():
        if len(suite.get(method, {}).get(name, {}).get("plates", ())) > len(found):
            continue
        done = [row for row in found if row["status"] == "done"]
        reasons = sorted({row["reason"] for row in found if row["status"] != "done"})
        figures = {key: [_rounded(row.get(key)) for row in done] for key in FIGURES}
        told = [row for row in run.get("numbers", ()) if (row["method"], row["row"]) == (method, name)]
        suite.setdefault(method, {})[name] = {
            "plates": [int(row["case"].rpartition("_")[2]) for row in found],
            "done": len(done),
            **figures,
            "numbers": numbers_of(told),
            "reasons": reasons,
            "device": about["device"],
            "code": about["code"][:12],
            "weights": {name: weights[name] for name in MEASURED_WITH},
        }
    tree["weights"] = {name: weights[name] for name in MEASURED_WITH}


def _rounded(value: Any) -> Any:
    return round(value, 4) if isinstance(value, float) else value


def titles(suite: str) -> dict[str, str]:
    """What differs, by row."""
    return {case.row: case.title for case in suite_cases(suite, 1)}


def methods_of(suite: Mapping[str, Any]) -> list[str]:
    """Methods that the table of a suite shows."""
    return [method for method in suite if method != "flat"]


def table(tree: Mapping[str, Any], suite: str) -> list[str]:
    """Lines of a suite's table in Markdown: means over plates, ``to come`` where nothing is stored."""
    found = tree["suites"].get(suite, {})
    methods = methods_of(found)
    head = ["what differs", "flat guess"]
    for method in methods:
        head += [f"`{method}`", "aligned", "within 1, 2 u", "warned", "explained"]
    lines = [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
    for name, title in titles(suite).items():
        cells = [f"{title}", _flat(found, name)]
        for method in methods:
            figures = found[method].get(name)
            cells += method_cells(figures)
            if figures is not None and method in WITH_NETWORKS and figures.get("weights") != tree["weights"]:
                cells[-5] += " \\*"
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def method_cells(figures: Mapping[str, Any] | None) -> list[str]:
    """Error, aligned error, coverage, how many were warned of and explained; of plates whose numbers are stored."""
    if figures is None:
        return ["to come", "", "", "", ""]
    plates, done = len(figures["plates"]), figures["done"]
    if not done:
        return ["refused", "", "", "", ""]
    covered = "-"
    if all(value is not None for value in figures["within_one"]):
        covered = _percent(figures, "") + " %"
        if ON_RELIEF in figures and all(value is not None for value in figures[ON_RELIEF]):
            covered += f" ({_percent(figures, '_on_relief')})"
    warned = f"{sum(map(bool, figures['warned']))} of {done}" + (f" ({plates - done} refused)" if done < plates else "")
    told = [value for value in figures["explained"] if value is not None]
    explained = f"{sum(told)} of {done}" if told else "-"
    return [_um(figures["rmse_um"]), _um(figures["rmse_aligned_um"]), covered, warned, explained]


def _percent(figures: Mapping[str, Any], where: str) -> str:
    """Points within one and two, over plates the mean."""
    return ", ".join(f"{100 * np.mean(figures[name + where]):.0f}" for name in ("within_one", "within_two"))


def _flat(suite: Mapping[str, Any], name: str) -> str:
    known = [rows[name]["flat_um"] for rows in suite.values() if name in rows and rows[name]["done"]]
    return _um(max(known, key=len)) if known else ""


def _um(values: Sequence[float]) -> str:
    mean = float(np.mean(values))
    return f"{mean:.0f}" if mean >= 100 else f"{mean:.1f}"


def with_tables(text: str, tree: Mapping[str, Any]) -> str:
    """The page with every table between its marks as stored."""
    for suite in SUITES:
        text = with_lines(text, f"table {suite}", table(tree, suite))
    text = with_lines(text, "trust", trust_table(tree["suites"], TRUSTED))
    return with_lines(text, "numbers", numbers_table(tree["suites"], TRUSTED))


def with_lines(text: str, mark: str, lines: Sequence[str]) -> str:
    """The page with these lines between a mark and the end of its table.

    Raises:
        SystemExit: the page has no such mark.
    """
    begin, end = f"<!-- {mark} -->\n", "<!-- end of table -->"
    pattern = re.compile(re.escape(begin) + ".*?" + re.escape(end), re.S)
    if not pattern.search(text):
        raise SystemExit(f"docs/bench.md has no place for {mark}; write {begin.strip()} and {end}")
    # In two pieces: what is put in may hold backslashes.
    before, after = pattern.split(text, maxsplit=1)
    return before + begin + "\n" + "\n".join(lines) + "\n\n" + end + after


def main(files: Sequence[Path]) -> None:
    """Take runs over, and write the tables."""
    tree = stored()
    weights = shipped() if files else {}
    for file in files:
        collect(tree, json.loads(file.read_text(encoding="utf-8")), weights)
    if files:
        # A list of figures is one line.
        text = re.sub(r"\[[^][{}]*\]", lambda found: " ".join(found[0].split()), json.dumps(tree, indent=1))
        FILE.write_text(text + "\n", encoding="utf-8")
    PAGE.write_text(with_tables(PAGE.read_text(encoding="utf-8"), tree), encoding="utf-8")


if __name__ == "__main__":
    main([Path(name) for name in sys.argv[1:]])
