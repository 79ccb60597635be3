"""Stored figures of the test bench, and the tables of its page."""

import json
import re
from pathlib import Path

import pytest

from benchmarks.bench import FIGURES, PAGE, SINCE, collect, method_cells, stored, table, titles, with_tables
from benchmarks.bench_numbers import UNITS, numbers_of, numbers_table
from benchmarks.bench_trust import NOT_FLAT, of_benches, trust_table
from data_gen.suites.suites import SUITES, suite_cases
from nets.evaluation.bench.coverage import REGIONS, WITHIN

ROOT = Path(__file__).parents[2]

WEIGHTS = {"direct": "", "direct-family": ""}


def run(device="cpu", n_photons=None, seed=None, plates=2, **others):
    scores = {"rmse_um": 12.34567, "rmse_aligned_um": 11.0, "slope_error": 0.1, "within_one": 0.5, "within_two": 0.9}
    row = {
        "row": "careful",
        "method": "direct",
        "status": "done",
        "warned": True,
        "explained": False,
        "time_s": 1.0,
        "reason": None,
    }
    row |= scores | {"flat_um": 300.0} | others
    about = {"suite": "lab", "device": device, "n_photons": n_photons, "seed": seed, "code": "c" * 64}
    return {"about": about, "rows": [row | {"case": f"careful_{k}"} for k in range(plates)]}


def test_the_page_shows_what_is_stored():
    """`make bench-lab`, or python -m benchmarks.bench, makes them the same again."""
    text = PAGE.read_text(encoding="utf-8")
    assert with_tables(text, stored()) == text


def test_what_is_stored_is_of_cases_that_there_are():
    tree = stored()
    assert set(tree["suites"]) <= set(SUITES)
    for suite, methods in tree["suites"].items():
        plates = SUITES[suite].plates
        for method, rows in methods.items():
            assert set(rows) <= set(titles(suite)), method
            for row in rows.values():
                assert all(0 <= plate < plates for plate in row["plates"]) and row["device"]
                assert {len(row[name]) for name in FIGURES if name in row} == {row["done"]}
                assert set(FIGURES) - set(row) <= set(SINCE)


def test_rows_of_earlier_networks_have_a_star():
    tree = {"suites": {}}
    collect(tree, run(), WEIGHTS)
    (now,) = (line for line in table(tree, "lab") if line.startswith("| careful"))
    tree["weights"] = {**WEIGHTS, "direct-family": "another"}
    (later,) = (line for line in table(tree, "lab") if line.startswith("| careful"))
    assert later == now.replace("| 12.3 |", "| 12.3 \\* |") != now


def test_the_page_counts_the_suites():
    text = PAGE.read_text(encoding="utf-8")
    counts = {name: (len({case.row for case in suite_cases(name)}), SUITES[name].plates) for name in SUITES}
    assert f"| `one-thing` | {counts['one-thing'][0]} rows of {counts['one-thing'][1]} plates |" in text
    assert f"| `prints` | {counts['prints'][0]} rows of {counts['prints'][1]} plates |" in text
    assert f"| `lab` | {counts['lab'][0]} benches of {counts['lab'][1]} plates |" in text
    assert f"| `ideal` | {counts['ideal'][1]} |" in text
    assert set(re.findall(r"^SUITES := (.*)$", (ROOT / "Makefile").read_text(encoding="utf-8"), re.M)) == {
        " ".join(SUITES)
    }


def test_rows_of_more_plates_stay():
    tree = {"suites": {}}
    weights = {"direct": "01234567", "direct-family": "89abcdef"}
    collect(tree, run(plates=3), weights)
    collect(tree, run(plates=2, rmse_um=1.0), weights)
    found = tree["suites"]["lab"]["direct"]["careful"]
    assert found["plates"] == [0, 1, 2] and found["rmse_um"] == [12.3457] * 3
    collect(tree, run(plates=3, rmse_um=1.0), weights)
    assert tree["suites"]["lab"]["direct"]["careful"]["rmse_um"] == [1.0] * 3
    assert tree["weights"] == weights
    lines = table(tree, "lab")
    assert lines[0] == "| what differs | flat guess | `direct` | aligned | within 1, 2 u | warned | explained |"
    assert lines[2].endswith("| 300 | 1.0 | 11.0 | 50, 90 % | 3 of 3 | 0 of 3 |")
    assert lines[3].endswith("|  | to come |  |  |  |  |")


def test_trials_and_given_heights_are_not_stored():
    for wrong in (run(n_photons=1000), run(seed=7), run(device=None)):
        with pytest.raises(SystemExit, match="are not stored"):
            collect({"suites": {}}, wrong, {})


def test_cells_of_refusals_and_of_methods_without_uncertainty():
    tree = {"suites": {}}
    collect(tree, run(plates=1, status="failed", reason="another scene", warned=None, explained=None), WEIGHTS)
    row = tree["suites"]["lab"]["direct"]["careful"]
    assert row["reasons"] == ["another scene"] and method_cells(row)[0] == "refused"
    collect(tree, run(plates=2, within_one=None, within_two=None, warned=False, explained=None), WEIGHTS)
    assert method_cells(tree["suites"]["lab"]["direct"]["careful"]) == ["12.3", "11.0", "-", "0 of 2", "-"]


def test_cells_show_what_is_covered_on_relief_where_it_was_counted():
    tree = {"suites": {}}
    collect(tree, run(within_one_on_relief=0.7, within_two_on_relief=0.94), WEIGHTS)
    assert method_cells(tree["suites"]["lab"]["direct"]["careful"])[2] == "50, 90 % (70, 94)"
    collect(tree, run(), WEIGHTS)
    assert method_cells(tree["suites"]["lab"]["direct"]["careful"])[2] == "50, 90 %"


def test_the_file_is_json_with_a_list_in_a_line():
    text = (ROOT / "benchmarks" / "bench.json").read_text(encoding="utf-8")
    assert json.loads(text)["suites"] and not re.search(r"\[\s*\n", text)


def test_the_table_of_trust_counts_plates_by_region():
    shares = {name + region: 0.7 for region in REGIONS for name in WITHIN} | {"within_two_on_relief": 0.9}
    known = shares | {"stated_um": 1.0, "doubted": True, "rmse_form_removed_um": 2.0}
    tree = {"suites": {}}
    collect(tree, run(plates=2, **known), WEIGHTS)
    # Rows of before have no regions.
    collect(tree, run(plates=3, row="poor"), WEIGHTS)
    collect(tree, run(plates=1, row="another", **known | {"rmse_um": 2.0, "within_one_on_folds": None}), WEIGHTS)
    lines = trust_table(tree["suites"], "direct")
    assert lines[0] == (
        "| suite | plates | bare | lines | folds | all relief | wrong | by their form | flagged | good, flagged |"
    )
    assert lines[2] == "| `lab` | 3 | 70, 70 % | 70, 70 % | 70, 70 % | 70, 90 % | 2 | 2 | 2 of 2 | 1 of 1 |"
    assert lines[3] == lines[2].replace("`lab`", "all")
    assert lines[4] == lines[2].replace("`lab`", "all, flat bases") and len(lines) == 5
    collect(tree, run(plates=1, row="bow", **known), WEIGHTS)
    with_bow = trust_table(tree["suites"], "direct")
    assert with_bow[3].startswith("| all | 4 |") and with_bow[4] == lines[4]
    assert trust_table({}, "direct")[-2] == "| all | 0 | - | - | - | - | 0 | 0 | - | 0 of 0 |"


def test_every_row_with_a_flat_base_has_one_kind_of_bench():
    rows = {case.row: {} for case in suite_cases("one-thing", 1)}
    kinds = of_benches(rows)
    assert sorted(name for some in kinds.values() for name in some) == sorted(set(rows) - set(NOT_FLAT))
    other = {"gap-10um", "gap-100um", "base-30um", "base-100um", "no-dispersion"}
    assert set(kinds["gap, base or glass other"]) == other
    assert {"nothing", "blur-2", "meanders"} <= set(kinds["bench as told"])
    assert {"lamp-1m", "scale-1", "fresnel"} <= set(kinds["other, but gap, base and glass as told"])


def number(name, told, true, found, sigma, **about):
    return {"name": name, "told": told, "true": true, "found": found, "sigma": sigma, **about}


def test_numbers_of_benches_are_told_apart_by_whether_they_are_as_told():
    """In the units of the table; those of another row or method are not a row's."""
    about = {"row": "careful", "method": "direct"}
    gaps = [
        number("gap_m", 1e-6, 11e-6, 13e-6, 4e-6, **about),
        number("gap_m", 1e-6, 11e-6, 21e-6, 4e-6, **about),
        number("gap_m", 1e-6, 1e-6, 1e-6, 3e-6, **about),
    ]
    tree = {"suites": {}}
    others = [number("ambient", 0.0, 0.03, 0.03, 1e-3, **about | {"row": "poor"})]
    collect(tree, run() | {"numbers": gaps + others}, WEIGHTS)
    assert tree["suites"]["lab"]["direct"]["careful"]["numbers"] == numbers_of(gaps)
    (line,) = numbers_table(tree["suites"], "direct")[2:]
    assert line == "| gap | um | 2 | 6 | 4 | 50, 50 % | 1 | 0 | 3 | 100, 100 % |"
    assert numbers_table(tree["suites"], "fibres")[2:] == []


def test_every_number_that_is_found_has_a_line():
    """But for the lamp's place, which is the light's slant."""
    known = {name for names in UNITS for name in names}
    stored_names = {
        name
        for suite in stored()["suites"].values()
        for row in suite.get("fibres", {}).values()
        for name in row.get("numbers", {}).get("name", ())
    }
    assert stored_names - known <= {"lamp_x_m", "lamp_y_m"} and len(stored_names & known) == len(known)
