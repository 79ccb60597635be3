"""The benchmark of coverage and warnings: what counts as wrong, flagged and covered."""

import numpy as np
import pytest

from benchmarks.trusted import OF_BENCH, OF_HEIGHTS, is_wrong, plates, summary
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


@pytest.mark.slow
def test_its_plates_are_of_its_seed():
    one, same, other = (next(plates("nothing", 1, seed, "cpu"))[1] for seed in (5, 5, 6))
    assert np.array_equal(one, same) and not np.array_equal(one, other)
