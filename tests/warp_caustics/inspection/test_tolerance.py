"""Which cells are out of tolerance, which cannot be told."""

import numpy as np
import pytest

from warp_caustics.errors import InputError
from warp_caustics.inspection.tolerance import level, vertical_limit, without_specks, zones

PITCH = (1e-3, 1e-3)


def everywhere(n=16):
    return np.ones((n, n), bool)


def test_limit_on_flat_plate_is_the_tolerance():
    np.testing.assert_allclose(vertical_limit(np.full((8, 8), 3e-4), 5e-5, PITCH), 5e-5)


def test_limit_on_a_plane_is_that_along_its_normal():
    """A plane of slope s moved by t along its normal moves up by t sqrt(1 + s^2)."""
    x, y = np.meshgrid(np.arange(8) * 1e-3, np.arange(8) * 1e-3)
    slope_x, slope_y = 2.0, -1.0
    limit = vertical_limit(slope_x * x + slope_y * y, 5e-5, PITCH)
    np.testing.assert_allclose(limit, 5e-5 * np.sqrt(1 + slope_x**2 + slope_y**2))


def test_a_slope_moved_aside_by_less_than_the_tolerance_is_in():
    """45 degrees, 40 um aside: 40 um of height, 28 um along the normal."""
    x = np.tile(np.arange(16) * 1e-3, (16, 1))
    found = zones(np.full((16, 16), 4e-5), None, vertical_limit(x, 3e-5, PITCH), everywhere())
    assert not found.out.any()
    assert zones(np.full((16, 16), 4e-5), None, np.full((16, 16), 3e-5), everywhere()).out.all()


def test_certain_and_undecided():
    """Beyond by more than two sigma is certain, by less undecided; within, but blind to an error of the limit, too."""
    deviation, sigma = np.zeros((16, 16)), np.full((16, 16), 1e-6)
    deviation[:4, :4] = 8e-5
    sigma[:4, :4] = 1e-5
    deviation[8:12, :4] = 6e-5
    sigma[8:12, :4] = 1e-5
    sigma[:4, 8:12] = 3e-5
    found = zones(deviation, sigma, np.full((16, 16), 5e-5), everywhere())
    out, undecided = np.zeros((16, 16), bool), np.zeros((16, 16), bool)
    out[:4, :4] = undecided[8:12, :4] = undecided[:4, 8:12] = True
    np.testing.assert_array_equal(found.out, out)
    np.testing.assert_array_equal(found.undecided, undecided)


def test_mask_is_not_judged_and_specks_are_dropped():
    deviation = np.full((16, 16), 1e-4)  # beyond tolerance, but no spike
    mask = np.zeros((16, 16), bool)
    mask[:3, :3] = True
    mask[10:12, 10:12] = True  # four cells: fewer than the least
    found = zones(deviation, None, np.full((16, 16), 5e-5), mask)
    assert found.out.sum() == 9 and found.out[:3, :3].all()
    with pytest.raises(InputError, match="leaves nothing"):
        zones(deviation, None, np.full((16, 16), 5e-5), np.zeros((16, 16), bool))


def test_specks_join_across_corners():
    marked = np.eye(6, dtype=bool)
    assert without_specks(marked, 6).sum() == 6
    assert without_specks(marked, 7).sum() == 0


def test_level_is_that_of_the_bare_plate():
    """A defect on most of the printed part does not move it."""
    nominal = np.zeros((16, 16))
    nominal[4:, 4:] = 3e-4
    deviation = np.full((16, 16), 7e-6)
    deviation[4:, 4:] += 2e-4
    assert level(deviation, nominal, everywhere())[0] == pytest.approx(7e-6)


def test_level_without_bare_plate_is_the_median_of_all():
    nominal = np.linspace(1e-4, 2e-4, 256).reshape(16, 16)
    offset, where = level(np.full((16, 16), 7e-6), nominal, everywhere())
    assert offset == pytest.approx(7e-6) and "all that is judged" in where
