"""Derivatives that are kept for more than one step."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from nets.reconstruct.fibres.bench import noise_slopes
from nets.reconstruct.fibres.bench.noise_slopes import Slopes


@pytest.fixture
def numbers():
    return np.random.default_rng(0)


def test_information_and_gradient_are_those_of_weighed_squares(numbers):
    """By another weight elsewhere, too; in double precision by numpy."""
    rows, rest = numbers.standard_normal((5, 3, 8, 8)), numbers.standard_normal((3, 8, 8))
    weight, other = numbers.random((2, 3, 8, 8))
    slopes = Slopes.of(iter(torch.from_numpy(rows)), 5, torch.from_numpy(weight))
    expected = np.einsum("acij,bcij,cij->ab", rows, rows, weight)
    np.testing.assert_allclose(slopes.information, expected, rtol=1e-5, atol=1e-4)
    for here in (weight, other):
        gradient = slopes.gradient(torch.from_numpy(rest), torch.from_numpy(here))
        np.testing.assert_allclose(gradient, np.einsum("acij,cij->a", rows, rest * here), rtol=1e-5, atol=1e-4)


def test_pixels_that_do_not_count_are_left_out(numbers):
    rows, rest = (torch.from_numpy(numbers.standard_normal(s)) for s in ((2, 1, 4, 4), (1, 4, 4)))
    weight = torch.ones(1, 4, 4, dtype=torch.float64)
    weight[0, 1] = 0
    slopes = Slopes.of(iter(rows), 2, weight)
    without = [rows[k, 0][[0, 2, 3]].numpy() for k in range(2)]
    np.testing.assert_allclose(slopes.information, [[(a * b).sum() for a in without] for b in without], rtol=1e-5)
    expected = [(a * rest[0][[0, 2, 3]].numpy()).sum() for a in without]
    np.testing.assert_allclose(slopes.gradient(rest, weight), expected, rtol=1e-5)


@pytest.mark.parametrize("count", [1, 3])
def test_as_many_derivatives_as_numbers(count):
    with pytest.raises(ValueError, match="shorter|longer"):
        Slopes.of(iter(torch.zeros(count, 1, 2, 2)), 2, torch.ones(1, 2, 2))


def test_derivatives_lie_where_there_is_room(monkeypatch):
    cpu, gpu = torch.device("cpu"), torch.device("cuda")
    monkeypatch.setattr(torch.cuda, "get_device_properties", lambda device: SimpleNamespace(total_memory=8 * 2**30))
    assert noise_slopes._home(2**30, gpu) == gpu and noise_slopes._home(2 * 2**30, gpu) == cpu
    assert noise_slopes._home(2**40, cpu) == cpu
