"""What is printed where lines cross: closed forms, limits, double precision and differences."""

import numpy as np
import pytest
import torch

from data_gen.variety import merged
from warp_caustics.prints.overlap import LEAST, joined, over, share

POWERS = (1.0, 0.7, 0.5, 0.25, 0.1, 0.03, 0.0)
PARTS = 1e-3 * torch.rand(5, 9, 9, generator=torch.Generator().manual_seed(3))
PARTS[:, 0] = 0.0
PARTS[1:, 1] = 0.0


def power(q):
    return np.inf if q == 0 else 1 / q


@pytest.mark.parametrize("q", POWERS)
def test_relief_is_that_of_double_precision(q):
    wanted = merged(PARTS.double().numpy(), power(q))
    np.testing.assert_allclose(joined(PARTS, q).numpy(), wanted, rtol=3e-6)


@pytest.mark.parametrize("q", POWERS)
def test_lines_may_be_printed_one_over_the_other(q):
    """In any order."""
    total = PARTS[0]
    for part in PARTS[1:]:
        total = over(total, part, q)
    np.testing.assert_allclose(total.numpy(), joined(PARTS, q).numpy(), rtol=1e-5)
    assert torch.equal(over(PARTS[0], PARTS[1], q), over(PARTS[1], PARTS[0], q))


@pytest.mark.parametrize("q", [1.0, 0.7, 0.5, 0.25, 0.1])
def test_shares_are_derivatives(q):
    parts = PARTS.double()[:, 2:]
    total, step = joined(parts, q), 1e-9
    for k in range(len(parts)):
        ends = []
        for sign in (-1, 1):
            moved = parts.clone()
            moved[k] += sign * step
            ends.append(joined(moved, q))
        np.testing.assert_allclose(
            share(parts[k], total, q).numpy(), ((ends[1] - ends[0]) / (2 * step)).numpy(), atol=1e-5
        )


def test_shares_of_the_highest_are_one_and_of_nothing_none():
    total = joined(PARTS, 0.0)
    assert torch.equal(share(PARTS, total, 0.0), (total <= PARTS).float())
    for q in (0.5, 0.1):
        bare = share(PARTS[:, 0], joined(PARTS, q)[0], q)
        assert torch.equal(bare, torch.zeros_like(bare))
    assert torch.equal(share(PARTS[0, 1], joined(PARTS, 0.3)[1], 0.3), torch.ones(9))


def test_equal_lines_in_closed_form():
    """n lines of height h make n^q h."""
    equal = torch.full((4, 1, 1), 3e-4)
    for q in (1.0, 0.5, 0.1, LEAST):
        assert float(joined(equal, q)) == pytest.approx(3e-4 * 4**q, rel=1e-5)


def test_no_lines_are_bare_plate():
    assert torch.equal(joined(PARTS[:0], 0.3), torch.zeros(9, 9))
