"""The spline surface against scipy and against its own derivatives."""

import numpy as np
import pytest
from scipy import ndimage

from warp_caustics.height_field import basis_matrix, cell_centres, prefilter_matrix, sample_coordinate

N = 12


@pytest.fixture
def heights(rng):
    return rng.standard_normal((N, N))


@pytest.fixture
def rng():
    return np.random.default_rng(3)


def test_spline_equals_scipy_order_3_mode_nearest(heights, rng):
    """Values agree with scipy's edge-extended cubic spline, up to and including the plate's edge."""
    u = np.concatenate([[-0.5, N - 0.5], rng.uniform(-0.5, N - 0.5, 50)])
    v = rng.permutation(u)
    prefilter = prefilter_matrix(N)
    rows, columns = basis_matrix(N, v, 0) @ prefilter, basis_matrix(N, u, 0) @ prefilter
    ours = np.einsum("pi,ij,pj->p", rows, heights, columns)
    # scipy pads by 12 samples itself, which leaves 1e-7 of the edge; more padding removes that.
    padded = np.pad(heights, 24, mode="edge")
    theirs = ndimage.map_coordinates(padded, [v + 24, u + 24], order=3, mode="nearest")
    np.testing.assert_allclose(ours, theirs, atol=1e-12)


def test_spline_interpolates_samples(heights):
    """At sample positions the spline is the sample."""
    matrix = basis_matrix(N, np.arange(N, dtype=float), 0) @ prefilter_matrix(N)
    np.testing.assert_allclose(matrix @ heights @ matrix.T, heights, atol=1e-13)


@pytest.mark.parametrize("derivative", [1, 2])
def test_derivative_matrices_match_central_differences(derivative, rng):
    """Derivatives per sample pitch equal differences of the next lower derivative."""
    # Knots are excluded: the third derivative jumps there.
    u = np.arange(N - 1) + rng.uniform(0.1, 0.9, N - 1)
    step = 1e-6
    difference = (basis_matrix(N, u + step, derivative - 1) - basis_matrix(N, u - step, derivative - 1)) / (2 * step)
    np.testing.assert_allclose(basis_matrix(N, u, derivative), difference, atol=1e-8)


def test_cell_centres_are_sample_coordinates():
    """Sample i sits at the centre of cell i."""
    np.testing.assert_allclose(sample_coordinate(cell_centres(N, 0.05), N, 0.05), np.arange(N), atol=1e-12)


def test_unknown_derivative_is_refused():
    with pytest.raises(ValueError, match="derivative 3"):
        basis_matrix(N, np.zeros(1), 3)
