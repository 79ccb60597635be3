"""What stored results of the test bench state, against what they are: a table of docs/bench.md, by suite and region."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from data_gen.suites.case import Case
from data_gen.suites.suites import suite_cases
from nets.evaluation.bench.coverage import REGIONS, WITHIN
from nets.evaluation.bench.detector import detection, is_wrong

TITLES = {"_bare": "bare", "_on_lines": "lines", "_on_folds": "folds", "_on_relief": "all relief"}
"""Of the regions that the table shows."""
TOLD = (
    "rmse_um",
    "rmse_form_removed_um",
    "stated_um",
    "doubted",
    *(name + region for region in REGIONS for name in WITHIN),
)
"""What is taken of a plate."""
NOT_FLAT = ("bow-20", "bow", "base-wave")
"""Rows whose bases bend light by a thousandth where nobody says how flat they are: no image tells that."""


def bends_light_as_told(case: Case) -> bool:
    """Whether gap, base and glass of a case are those that methods are told."""
    parts = [(each.base_thickness_m, each.screen_position_m[2], each.glass_indices) for each in (case.scene, case.told)]
    return parts[0] == parts[1]


def of_benches(rows: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Mapping[str, Any]]]:
    """Rows of ``one-thing`` with flat bases by what their bench is, which decides what can be stated."""
    found: dict[str, dict[str, Mapping[str, Any]]] = {
        "bench as told": {},
        "gap, base or glass other": {},
        "other, but gap, base and glass as told": {},
    }
    exact, parts, rest = found.values()
    for case in suite_cases("one-thing", 1):
        if case.row in rows and case.row not in NOT_FLAT:
            kind = exact if case.is_bench_exact else rest if bends_light_as_told(case) else parts
            kind[case.row] = rows[case.row]
    return found


def plates_of(rows: Mapping[str, Mapping[str, Any]]) -> Iterator[dict[str, Any]]:
    """Stored plates of a method that state an uncertainty; rows that were stored before :data:`TOLD` lack some."""
    for row in rows.values():
        if all(name in row for name in TOLD):
            for values in zip(*(row[name] for name in TOLD), strict=True):
                if values[TOLD.index("stated_um")] is not None:
                    yield dict(zip(TOLD, values, strict=True))


def shares(plates: Sequence[Mapping[str, Any]], region: str) -> tuple[float, float] | None:
    """Shares within one and two of a region, means over the plates that have some of it; None if none has."""
    known = [
        [plate[name + region] for name in WITHIN] for plate in plates if plate[next(iter(WITHIN)) + region] is not None
    ]
    if not known:
        return None
    one, two = np.mean(known, axis=0)
    return float(one), float(two)


def trust_table(suites: Mapping[str, Mapping[str, Any]], method: str) -> list[str]:
    """Lines of the table in Markdown: each suite, ``one-thing`` by its benches, all, and all but :data:`NOT_FLAT`."""
    rows = {suite: suites[suite].get(method, {}) for suite in suites}
    flat = [{name: row for name, row in some.items() if name not in NOT_FLAT} for some in rows.values()]
    by_suite = {f"`{suite}`": list(plates_of(some)) for suite, some in rows.items()}
    by_suite = {suite: plates for suite, plates in by_suite.items() if plates}
    whole = [plate for plates in by_suite.values() for plate in plates]
    by_suite |= {
        f"`one-thing`, {title}": list(plates_of(some)) for title, some in of_benches(rows.get("one-thing", {})).items()
    }
    by_suite = {name: plates for name, plates in by_suite.items() if plates}
    by_suite["all"] = whole
    by_suite["all, flat bases"] = [plate for some in flat for plate in plates_of(some)]
    head = ["suite", "plates", *TITLES.values(), "wrong", "by their form", "flagged", "good, flagged"]
    lines = [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
    for name, plates in by_suite.items():
        cells = [name, str(len(plates)), *(_percent(shares(plates, region)) for region in TITLES)]
        lines.append(f"| {' | '.join(cells + _counts(plates))} |")
    return lines


def _percent(found: tuple[float, float] | None) -> str:
    return "-" if found is None else f"{100 * found[0]:.0f}, {100 * found[1]:.0f} %"


def _counts(plates: Sequence[Mapping[str, Any]]) -> list[str]:
    """Wrong results, of these those whose form alone is wrong (a bow), flagged ones, and good ones that are flagged."""
    found = detection(plates)
    form = sum(
        is_wrong(plate["rmse_um"], plate["stated_um"])
        and not is_wrong(plate["rmse_form_removed_um"], plate["stated_um"])
        for plate in plates
    )
    flagged = f"{found.wrong_flagged} of {found.wrong}" if found.wrong else "-"
    return [str(found.wrong), str(form), flagged, f"{found.good_flagged} of {found.good}"]
