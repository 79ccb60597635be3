"""Errors after the best move sideways."""

import numpy as np
import pytest

from nets.evaluation.alignment import aligned_rmse_um
from warp_caustics.prints.line import Line, line_relief


def relief(dx=0.0, dy=0.0):
    lines = [((-0.012, -0.01), (0.012, 0.008)), ((0.01, -0.015), (-0.008, 0.014))]
    return line_relief(
        [Line((a + dx, b + dy), (c + dx, d + dy), 6e-3, 3e-4) for (a, b), (c, d) in lines], 64, (0.05, 0.05)
    )


def test_a_moved_relief_is_right_once_it_is_moved_back():
    pitch = 0.05 / 64
    true, moved = relief(), relief(0.7 * pitch, -0.4 * pitch)
    before = 1e6 * np.sqrt(np.mean((moved - true) ** 2))
    assert before > 10
    assert aligned_rmse_um(moved, true) < 0.02 * before


def test_an_error_that_is_no_move_stays():
    true = relief()
    noise = 5e-6 * np.random.default_rng(0).standard_normal(true.shape)
    assert aligned_rmse_um(true + noise, true) == pytest.approx(5, rel=0.03)
    assert aligned_rmse_um(true, true) == pytest.approx(0, abs=1e-6)
