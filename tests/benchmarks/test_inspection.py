"""The benchmark of inspections: a plate is good if its true relief is."""

import dataclasses

import numpy as np

from benchmarks.inspection import SHIFT_M, Plate, false_alarms, true_verdict
from warp_caustics.inspection.nominal import Nominal
from warp_caustics.prints.line import Line, line_relief, moved_across
from warp_caustics.scene import Scene

SCENE = Scene(height_samples=64, image_pixels=64)
LINE = Line((-0.015, -0.01), (0.015, 0.01), 4e-3, 3e-4)


def plate(printed):
    return Plate([LINE], [printed], None, 0, line_relief([printed], 64, SCENE.plate_size_m), None)


def test_a_plate_printed_out_of_tolerance_is_no_good_one():
    """Without a defect, but moved by 1 mm where 50 um are allowed."""
    nominal = Nominal.of_lines([LINE], SCENE)
    near = dataclasses.replace(LINE, height_m=LINE.height_m + 1e-5)
    assert np.abs(plate(near).truth_m - nominal.relief_m).max() > 9e-6
    assert true_verdict(plate(near), nominal, SCENE) == "pass"
    assert true_verdict(plate(moved_across(LINE, SHIFT_M, SHIFT_M)), nominal, SCENE) == "fail"


def test_only_good_plates_that_fail_are_false_alarms():
    rows = [("pass", "pass"), ("pass", "fail"), ("fail", "fail"), ("fail", "pass"), ("pass", "uncertain")]
    told = false_alarms([{"true_verdict": truth, "verdict": found} for truth, found in rows])
    assert told == "truly good: 3, false alarms 1; truly out of tolerance: 2, passed 1"
