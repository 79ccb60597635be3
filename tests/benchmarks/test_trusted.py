"""The benchmark of coverage and warnings: what counts as wrong, flagged and covered."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from benchmarks.trusted import OF_BENCH, OF_HEIGHTS, constants, is_wrong, plates, summary
from warp_caustics.found_bench.rest_causes import Cause, RestCauses


def row(name, rmse, sigma, flagged, causes=()):
    covered = [0.6, 0.9]
    return {
        "row": name, "plate": 0, "rmse_um": rmse, "uncertainty_um": sigma, "alone_um": sigma / 2,
        "within": covered, "within_relief": covered, "alone_within": [0.4, 0.7], "alone_within_relief": [None, None],
        "ratio": 1.0, "causes": list(causes), "is_flagged": flagged,
    }  # fmt: skip


def test_wrong_is_three_times_what_is_stated():
    assert is_wrong(row("a", 31, 10, False)) and not is_wrong(row("a", 29, 10, False))
    assert is_wrong(row("a", 29, 10, False), "alone_um")


def test_the_summary_counts_wrong_and_good_ones_apart():
    rows = [row("a", 40, 10, True, [["ambient", 0.02, 0.004]]), row("a", 5, 10, False), row("b", 40, 10, False)]
    lines = summary([*rows, row("b", 5, 10, True)])
    assert "wrong by all: 1 of 2 flagged; good: 1 of 2 flagged" in lines
    assert any(line.startswith("a ") and "ambient 1" in line for line in lines)
    assert any("0.60/0.90" in line for line in lines)


def test_its_words_are_those_of_the_warnings():
    rest = {"beyond_noise": 0.05, "even": 0.0, "bright": 0.04, "between": 0.03, "coarse": 0.0}
    (of_bench,) = RestCauses(rest, (Cause("screen_x_m", "moved", 1e-4, 1e-5, is_bench=True),)).warnings()
    (of_heights,) = RestCauses(rest, (), 9.0).warnings()
    assert OF_BENCH in of_bench and OF_HEIGHTS in of_heights


STORED = json.loads(Path("benchmarks/trusted.json").read_text())


def test_stored_coverage_is_of_the_constants_that_ship():
    """A factor, floor or share of another size has to be measured, and told on the page."""
    assert {file: pytest.approx(values) for file, values in STORED["constants"].items()} == constants()
    text = " ".join(Path("docs/trust.md").read_text().split())
    pattern = r"k = ([\d.]+), c = ([\d.]+) for the scene's own network, ([\d.]+), ([\d.]+) and a floor f of ([\d.]+) um"
    own, told = constants().values()
    wanted = own["scale"], own["shared"], told["scale"], told["shared"], told["floor_um"]
    assert [float(value) for value in re.search(pattern, text).groups()] == pytest.approx(wanted)


@pytest.mark.parametrize("network", ["direct.safetensors", "direct-family.safetensors"])
def test_benches_told_nearly_are_covered_on_relief(network):
    """Plates that the constants were not fitted to: 68 and 95 % of a normal distribution, within what few plates tell."""
    rows = [row for row in STORED["rows"] if row["row"] in ("nothing", "careful") and row["network"] == network]
    covered = np.mean([row["within_relief"] for row in rows], axis=0)
    assert len(rows) >= 2 and 0.6 < covered[0] < 0.95 and covered[1] > 0.9, covered


@pytest.mark.slow
def test_its_plates_are_of_its_seed():
    one, same, other = (next(plates("nothing", 1, seed, "cpu"))[1] for seed in (5, 5, 6))
    assert np.array_equal(one, same) and not np.array_equal(one, other)
