"""Lowest and highest of heights, for which the host looks while a GPU simulates; here without one."""

import math
import threading

import pytest
import torch

from warp_caustics import extremes as module
from warp_caustics.extremes import Extremes

CPU = torch.device("cpu")


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_both_are_found(dtype):
    extremes = Extremes(CPU, dtype)
    for values in ([[1.0, -3.0], [0.5, 2.0]], [[7.0, 7.0]]):
        extremes.find(torch.tensor(values, dtype=dtype))
        assert extremes.read() == (min(map(min, values)), max(map(max, values)))


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf])
def test_what_is_no_number_shows(wrong):
    extremes = Extremes(CPU, torch.float32)
    extremes.find(torch.tensor([0.0, wrong, 1.0]))
    assert not all(map(math.isfinite, extremes.read()))


def test_the_host_waits_for_both():
    """For what was asked last, and not for half of it."""
    extremes = Extremes(CPU, torch.float32)
    extremes.find(torch.tensor([-1.0, 1.0]))
    assert extremes.read() == (-1.0, 1.0)
    extremes.ask(torch.zeros(1))
    found = []
    reader = threading.Thread(target=lambda: found.append(extremes.read()))
    reader.start()
    for place, value in enumerate((-2.0, 5.0)):
        reader.join(0.02)
        assert not found
        extremes._seen[place] = value
    reader.join(5.0)
    assert found == [(-2.0, 5.0)]


def test_a_gpu_that_never_answers_is_asked(monkeypatch):
    """Which raises where it has failed."""

    def failed(device):
        raise RuntimeError(f"{device}: an illegal memory access was encountered")

    monkeypatch.setattr(module, "PATIENCE_S", 0.01)
    monkeypatch.setattr(torch.cuda, "synchronize", failed)
    extremes, heights = Extremes(CPU, torch.float32), torch.zeros(1)
    extremes.ask(heights)
    with pytest.raises(RuntimeError, match="illegal memory access"):
        extremes.read()
    # Where the heights are it may never have heard, and is told anew.
    extremes._address.zero_()
    extremes.ask(heights)
    assert int(extremes._address) == heights.data_ptr()
