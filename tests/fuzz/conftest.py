"""Bounds of every attempt, and how many there are.

A short part runs with every test run; ``-m slow`` runs the same for longer. Seeds are fixed: what fails fails again.
"""

import resource
import sys
from pathlib import Path

import pytest

HERE = str(Path(__file__).parent)
if HERE not in sys.path:
    sys.path.insert(0, HERE)

MAX_GROWTH = 1_500_000_000
"""Of the peak memory over all attempts of a kind [bytes]."""


@pytest.fixture(autouse=True)
def bounded_memory():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    yield
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 - before < MAX_GROWTH


@pytest.fixture(params=[pytest.param(1, id="short"), pytest.param(20, id="long", marks=pytest.mark.slow)])
def rounds(request):
    return request.param
