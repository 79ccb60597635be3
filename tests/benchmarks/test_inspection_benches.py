"""Plates with planted defects on the benches of ``lab``, and how an inspection of them is scored."""

import dataclasses

import numpy as np
import pytest

from benchmarks.inspection_benches import case_of, plates, summary, true_relief
from benchmarks.planted_defects import DEFECTS, printed_plate, scored
from warp_caustics.inspection.judge import judge_plate
from warp_caustics.inspection.nominal import Nominal
from warp_caustics.prints.line import line_relief
from warp_caustics.scene import Scene

SCENE = Scene()


@pytest.mark.parametrize("defect", DEFECTS)
def test_a_planted_defect_is_out_of_tolerance_and_its_true_relief_is_named(defect):
    """What an inspection without any error would say."""
    plate = printed_plate(np.random.default_rng(6), defect)
    nominal = Nominal.of_lines(plate.designed, SCENE)
    truth = line_relief(plate.printed, SCENE.height_samples, SCENE.plate_size_m)
    row = scored(plate, judge_plate(truth, nominal, SCENE, 5e-5))
    assert row["verdict"] == "fail" and row["located"] and row["named"] and not row["others_named"]


def test_a_plate_is_the_same_whatever_was_drawn_before():
    case = case_of("ordinary", 3)
    first, again = (printed_plate(case.plate.rng("defects"), None) for _ in range(2))
    assert first.printed == again.printed and first.designed != first.printed
    other = case_of("careful", 3)
    assert printed_plate(other.plate.rng("defects"), None).designed != first.designed


def test_a_bow_of_the_base_is_part_of_the_truth():
    case = case_of("poor", 0)
    plate = dataclasses.replace(printed_plate(case.plate.rng("defects"), None), printed=[])
    assert true_relief(case, plate).max() == pytest.approx(2 * case.plate.bow_m, rel=0.05)


def test_every_bench_and_defect_is_begun_with():
    listed = list(plates(["careful", "poor"], 3, 1))
    assert len(listed) == len(set(listed)) == 2 * (3 + len(DEFECTS))
    assert {(bench, kind) for bench, kind, _ in listed[:12]} == {
        (bench, kind) for bench in ("careful", "poor") for kind in (None, *DEFECTS)
    }


def test_only_good_plates_that_fail_are_false_alarms():
    row = {"bench": "careful", "defect": "none", "true_verdict": "pass", "verdict": "fail", "rmse_um": 1.0}
    told = "\n".join(summary([row, row | {"true_verdict": "fail"}, row | {"defect": "extra", "named": True}]))
    assert "1: 0 pass, 0 uncertain, 1 fail" in told and "truly out of tolerance: 1" in told
    assert "named 1" in told
