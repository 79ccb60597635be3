"""The tolerance zone of lines on samples."""

import numpy as np
import pytest

from warp_caustics.inspection.tolerance import vertical_limit
from warp_caustics.prints.line import Line, line_relief, moved_across
from warp_caustics.prints.tolerance import line_limit

PLATE, N, T = (0.05, 0.05), 64, 5e-5
PITCH = (PLATE[0] / N, PLATE[1] / N)
NARROW = Line((-0.02, -0.0101), (0.02, 0.0037), 3e-4, 1.2e-3)
"""Less than half a cell wide."""


def test_bare_plate_has_the_tolerance_itself():
    limit = line_limit([NARROW], N, PLATE, T)
    far = line_relief([Line(NARROW.start_m, NARROW.end_m, 3e-3, 1.0)], N, PLATE) == 0
    np.testing.assert_allclose(limit[far], T)


@pytest.mark.parametrize("shift", [0.9 * T, -0.9 * T])
def test_a_narrow_fibre_may_lie_aside_by_the_tolerance(shift):
    """Its slope on the samples allows less than that."""
    nominal = line_relief([NARROW], N, PLATE)
    moved = line_relief([moved_across(NARROW, shift, shift)], N, PLATE) - nominal
    assert (np.abs(moved) <= line_limit([NARROW], N, PLATE, T)).all()
    assert (np.abs(moved) > vertical_limit(nominal, T, PITCH)).any()


def test_twice_the_tolerance_aside_is_out():
    moved = line_relief([moved_across(NARROW, 3 * T, 3 * T)], N, PLATE) - line_relief([NARROW], N, PLATE)
    assert (np.abs(moved) > line_limit([NARROW], N, PLATE, T)).sum() > 10


def test_on_a_wide_line_it_is_the_slope():
    """Away from its ends; the slope from samples is one-sided and a little larger."""
    wide = Line((-0.02, 0.0), (0.02, 0.0), 1.2e-2, 2e-3)
    limit = line_limit([wide], N, PLATE, T)[:, 20:44]
    slope = np.gradient(line_relief([wide], N, PLATE), PITCH[1], axis=0)[:, 20:44]
    np.testing.assert_allclose(limit, T * np.sqrt(1 + slope**2), rtol=0.05)
