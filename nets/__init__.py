"""The learned parts: the paper's family of networks, this project's own, and their weights.

Names are imported on first use, so that ``import nets`` stays cheap.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nets.architecture import build as build
    from nets.weights import load_weights as load_weights
    from nets.weights import save_weights as save_weights

_HOMES = {"build": "nets.architecture", "load_weights": "nets.weights", "save_weights": "nets.weights"}

__all__ = ["build", "load_weights", "save_weights"]


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(importlib.import_module(_HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
