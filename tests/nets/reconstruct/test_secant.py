"""Steps lengthened along a secant."""

import pytest

from nets.reconstruct.bench_search import ROUNDS
from nets.reconstruct.secant import FURTHER, FURTHEST, lengthened


def walked(true, kept, sigma=0.07):
    """Values after each round where heights keep the share ``kept(apart)`` of what a bench is off by to themselves."""
    value, was, values = 0.0, None, [0.0]
    while len(values) < ROUNDS:
        move = (1 - kept(true - value)) * (true - value)
        if abs(move) < sigma:
            break
        further = lengthened(value, move, sigma, was)
        value, was = value + further, (value, move)
        values.append(value)
    return values


@pytest.mark.parametrize("true", [4.4, -4.4, 0.5])
def test_steps_arrive_where_heights_keep_more_of_a_bench_the_farther_it_is(true):
    """As with a picture 1 % too large: steps of a tenth of the way that do not get shorter for half of it."""
    values = walked(true, lambda apart: min(0.92, 0.36 + 0.16 * abs(apart)))
    assert abs(values[-1] - true) < 0.15 and len(values) < ROUNDS
    plain, value = [], 0.0
    for _ in range(6):
        value += FURTHER * (1 - min(0.92, 0.36 + 0.16 * abs(true - value))) * (true - value)
        plain.append(value)
    assert abs(true) < 1 or abs(plain[-1] - true) > 0.15


def test_a_step_is_lengthened_to_where_the_secant_ends_within_limits():
    assert lengthened(0.0, 1.0, 0.1, None) == FURTHER
    assert lengthened(1.5, 0.5, 0.1, (0.0, 2.0)) == pytest.approx(0.5)  # slope -1: the step itself
    assert lengthened(1.5, 1.0, 0.1, (0.0, 2.0)) == pytest.approx(1.5)
    assert lengthened(1.5, -1.0, 0.1, (0.0, 2.0)) == pytest.approx(-0.5)  # overshot: back in between
    assert lengthened(1.5, 1.9, 0.1, (0.0, 2.0)) == pytest.approx(FURTHEST * 1.9)
    assert lengthened(1.5, 2.5, 0.1, (0.0, 2.0)) == pytest.approx(FURTHEST * 2.5)  # steps that grow


def test_what_is_within_its_deviation_tells_no_secant():
    assert lengthened(1.5, 0.05, 0.1, (0.0, 2.0)) == pytest.approx(FURTHER * 0.05)
    assert lengthened(0.05, 1.0, 0.1, (0.0, 2.0)) == pytest.approx(FURTHER)
