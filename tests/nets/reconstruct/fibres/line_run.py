"""A run of lines that is nothing but what changes, for tests of single steps."""

from types import SimpleNamespace
from typing import Any

import torch


def line_run(**about: Any) -> SimpleNamespace:
    """All that :class:`~nets.reconstruct.fibres.bench.run_state.LinesRun` has, and what a test needs beside it."""
    plain = {"lines": torch.zeros(1), "view": None, "model": SimpleNamespace(shape=None), "bench": 0, "numbers": None}
    without = {"moves_section": False, "is_elsewhere": False, "covariance": None, "counted": None, "asked": ()}
    return SimpleNamespace(**plain | without | about)
