"""Whether a result says that its heights may be wrong by more than it states."""

import math
from dataclasses import asdict

import numpy as np
import pytest

from warp_caustics.found_bench.care import UNTOLD
from warp_caustics.found_bench.doubt import UNEXPLAINED, doubt_of
from warp_caustics.found_bench.rest_causes import Cause

PARTS = {
    "network_um": 4.0,
    "bench_um": 3.0,
    "numbers": {name: {"sigma": 1e-6, "um": 1.0} for name in UNTOLD} | {"vergence_per_m": {"sigma": 0.02, "um": 2.0}},
}


def counters(*causes, ratio=0.5, parts=PARTS):
    found = {"rest": {"ratio": ratio, "causes": [asdict(cause) for cause in causes]}}
    return found if parts is None else found | {"uncertainty": parts}


def test_a_result_that_its_uncertainty_explains_is_in_no_doubt():
    doubt = doubt_of(counters(), 5.0)
    assert doubt.times == pytest.approx(1) and not doubt.is_doubtful and not doubt.warnings()


def test_more_left_than_the_image_part_explains_is_warned_of():
    """What the bench leaves uncertain leaves nothing of an image, and is not multiplied."""
    doubt = doubt_of(counters(ratio=3.0), 5.0)
    assert doubt.times == pytest.approx(math.hypot(3 * 4, 3) / 5) and doubt.is_doubtful
    assert "3 times as much is left" in doubt.warnings()[0] and "they may be wrong by more" in doubt.warnings()[0]
    shaded = counters(ratio=3.0, parts=PARTS | {"bench_um": 40.0})
    assert not doubt_of(shaded, math.hypot(4, 40)).is_doubtful


def test_a_cause_that_the_uncertainty_has_a_part_of_is_no_warning():
    lamp = Cause("vergence_per_m", "a lamp", 1.0, 0.1, is_bench=True)
    within = doubt_of(counters(lamp), 5.0)
    assert not within.is_doubtful
    for parts, stated in ((None, 5.0), (None, None), (PARTS | {"numbers": {}}, 5.0)):
        without = doubt_of(counters(lamp, parts=parts), stated)
        assert without.is_doubtful and "a lamp: 1 +- 0.1" in without.warnings()[0]


@pytest.mark.parametrize("stated_um", [5.0, None])
def test_lines_that_leave_several_times_the_noise_are_in_doubt_whatever_they_state(stated_um):
    """Heights that are free leave more by nature, and are judged by what their uncertainty leaves."""
    for left, by, is_doubtful in (
        (0.9 * UNEXPLAINED, "fibres", False),
        (1.1 * UNEXPLAINED, "fibres", True),
        (1.1 * UNEXPLAINED, "network", False),
        (None, "fibres", False),
    ):
        doubt = doubt_of(counters() | {"discrepancy": left, "explained_by": by}, stated_um)
        assert doubt.is_doubtful == is_doubtful and doubt.record["is_doubtful"] == is_doubtful
        assert len(doubt.warnings()) == is_doubtful
    curves = {"discrepancy": 8.7, "explained_by": "fibres", "curves": {"lines": 11}}
    assert not doubt_of(counters() | curves, stated_um).is_doubtful, (
        "asked how far light goes, and right but for places"
    )
    (told,) = doubt_of(counters() | {"discrepancy": 8.7, "explained_by": "fibres"}, stated_um).warnings()
    assert "8.7 times the noise" in told and "check gap, base and lamp" in told


def test_without_an_uncertainty_nothing_is_said_of_it():
    doubt = doubt_of(counters(ratio=None, parts=None), None)
    assert doubt.times is None and not doubt.is_doubtful and not doubt.warnings()


def test_heights_that_claim_to_be_exact_are_not_divided_by():
    parts = PARTS | {"network_um": 0.0, "bench_um": 0.0, "numbers": {}}
    assert np.isfinite(doubt_of(counters(parts=parts, ratio=1000.0), 0.0).times)
