"""Steps to a least within bounds."""

import numpy as np
import pytest

from nets.reconstruct.fibres.bench.bounded_least import BoundedLeast

FREE = np.full(3, -np.inf), np.full(3, np.inf)
MATRIX = np.array([[4.0, 1.0, 0.0], [1.0, 3.0, 0.5], [0.0, 0.5, 2.0]])


def least(gradient, lowest=FREE[0], highest=FREE[1], matrix=MATRIX):
    return BoundedLeast(np.zeros(1), matrix, np.asarray(gradient, float), np.asarray(lowest), np.asarray(highest))


def test_without_bounds_it_is_newtons_step():
    about = least([1.0, -2.0, 0.3])
    step = about.step()
    np.testing.assert_allclose(MATRIX @ step, -about.gradient, atol=1e-7)
    assert about.gain(step) == pytest.approx(-about.gradient @ step)


def test_numbers_that_are_held_are_made_up_for_by_the_others():
    about = least([1.0, -2.0, 0.3], highest=[np.inf, 0.1, np.inf])
    step = about.step()
    assert step[1] == pytest.approx(0.1)
    others = [0, 2]
    rest = -(about.gradient[others] + MATRIX[others, 1] * 0.1)
    np.testing.assert_allclose(MATRIX[np.ix_(others, others)] @ step[others], rest, atol=1e-7)


def test_a_number_at_its_end_is_held_by_where_all_go():
    """Its own slope points beyond the end, where all together go to the other side."""
    matrix = np.array([[1.0, 0.9], [0.9, 1.0]])
    gradient = -matrix @ np.array([-1.0, 0.5])
    assert gradient[1] > 0, "by itself it would fall"
    about = least(gradient, [-np.inf, 0.0], [np.inf, np.inf], matrix)
    np.testing.assert_allclose(about.step(), [-1.0, 0.5], atol=1e-6)


def test_numbers_that_may_not_move_and_those_before_the_first_stay():
    about = least([1.0, -2.0, 0.3], lowest=[-np.inf, -np.inf, 0.0], highest=[np.inf, np.inf, 0.0])
    assert about.step()[2] == 0
    later = least([1.0, -2.0, 0.3]).step(1)
    assert later[0] == 0
    np.testing.assert_allclose(MATRIX[1:, 1:] @ later[1:], [2.0, -0.3], atol=1e-7)


def test_widely_different_units_are_no_matter():
    scale = np.array([1e6, 1.0, 1e-4])
    about = least(np.array([1.0, -2.0, 0.3]) * scale, matrix=MATRIX * np.outer(scale, scale))
    np.testing.assert_allclose(about.step() * scale, least([1.0, -2.0, 0.3]).step(), rtol=1e-6)


def test_numbers_that_are_one_share_a_step():
    """Two lines on top of each other, whose matrix rounding has made one of no squares."""
    twice = np.array([[1.0, 1.0 + 2e-8, 0.1], [1.0 + 2e-8, 1.0, 0.1], [0.1, 0.1, 1.0]])
    step = least([-0.8, -0.8, 0.3], matrix=twice).step()
    assert step[0] == pytest.approx(step[1], abs=1e-3)
    np.testing.assert_allclose(twice @ step, [0.8, 0.8, -0.3], atol=1e-5)
