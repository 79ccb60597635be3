"""Mixed precision: which context a network runs in."""

import contextlib
from typing import Any

import torch

from nets.training.config import Precision

_DTYPES = {"bf16": torch.bfloat16, "16": torch.float16}


def autocast(precision: Precision, device: torch.device) -> contextlib.AbstractContextManager[Any]:
    """Context for calls of a network, and of nothing else: the simulator's matrix products need all digits."""
    dtype = _DTYPES.get(precision)
    return torch.autocast(device.type, dtype) if dtype is not None else contextlib.nullcontext()
