"""Descents that are evaluated together, against closed forms, SciPy, and each by itself."""

import numpy as np
import pytest
import scipy

from warp_caustics.prints.vectorise.side_by_side import descend_side_by_side

FREE = np.inf


def bowls(centres, stiffness):
    """Functions sum_i k_i (u_i - c_i)^2 / 2, and their gradients."""

    def objective(u):
        off = u - centres
        return (stiffness * off**2).sum(axis=1) / 2, stiffness * off

    return objective


def valley(u):
    """Rosenbrock's function of pairs of numbers, each row scaled by its number."""
    scale = 1.0 + np.arange(len(u))
    x, y = u.T
    gradient = np.stack([-2 * (1 - x) - 400 * x * (y - x**2), 200 * (y - x**2)], axis=1)
    return scale * ((1 - x) ** 2 + 100 * (y - x**2) ** 2), scale[:, None] * gradient


def found_by(objective, start, low=-FREE, high=FREE, iterations=60):
    start = np.asarray(start, float)
    ends = np.full(start.shape, low), np.full(start.shape, high)
    return descend_side_by_side(objective, start, *ends, iterations=iterations, converged=1e-12)


def test_bowls_end_in_their_middle_or_at_the_bound():
    rng = np.random.default_rng(0)
    centres, stiffness = rng.uniform(-3, 3, (5, 4)), 10.0 ** rng.uniform(-1, 2, (5, 4))
    free = found_by(bowls(centres, stiffness), np.zeros((5, 4)))
    np.testing.assert_allclose(free.numbers, centres, atol=1e-4)
    held = found_by(bowls(centres, stiffness), np.zeros((5, 4)), -1.0, 1.0)
    np.testing.assert_allclose(held.numbers, centres.clip(-1, 1), atol=1e-4)
    np.testing.assert_allclose(held.losses, bowls(centres, stiffness)(held.numbers)[0])


@pytest.mark.parametrize("bound", [FREE, 0.5])
def test_a_bent_valley_ends_where_scipy_does(bound):
    starts = np.array([[-1.2, 0.4], [0.0, 0.0], [-0.5, -0.7]])
    found = found_by(valley, starts, -FREE, bound, iterations=120)
    for k, start in enumerate(starts):
        one = scipy.optimize.minimize(
            lambda u: valley(u[None])[0][0], start, method="L-BFGS-B", bounds=[(None, bound)] * 2
        )
        assert found.losses[k] <= (1 + k) * one.fun + 1e-6


def test_each_goes_as_it_would_alone():
    """Others that take longer, or fail, change nothing."""
    starts = np.array([[-1.2, 1.0], [1.0, 1.0], [30.0, -20.0]])
    together = found_by(valley, starts, iterations=15)
    for k, start in enumerate(starts):
        alone = found_by(lambda u, k=k: tuple((1 + k) * value for value in valley(u)), start[None], iterations=15)
        np.testing.assert_allclose(together.numbers[k], alone.numbers[0])


def test_it_is_never_worse_than_where_it_begins():
    """A function whose gradient is wrong, and one that is at its least."""

    def objective(u):
        return (u**2).sum(axis=1), np.array([[-2.0], [2.0]]) * u

    found = found_by(objective, [[1.0, 2.0], [0.0, 0.0]])
    np.testing.assert_array_equal(found.numbers, [[1.0, 2.0], [0.0, 0.0]])
    np.testing.assert_array_equal(found.losses, [5.0, 0.0])


def test_numbers_that_a_function_does_not_have_stay():
    centres, stiffness = np.array([[1.0, 2.0], [3.0, 0.0]]), np.array([[1.0, 1.0], [1.0, 0.0]])
    found = found_by(bowls(centres, stiffness), [[0.0, 0.0], [0.0, 7.0]])
    np.testing.assert_allclose(found.numbers, [[1.0, 2.0], [3.0, 7.0]], atol=1e-5)
    assert found.evaluations < 12
