"""Caustics of printed glass plates: simulation, exact gradients, reconstruction.

Names are imported on first use, so that ``import warp_caustics`` stays cheap.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from warp_caustics.scene import Scene as Scene
    from warp_caustics.simulator import CausticSimulator as CausticSimulator

_HOMES = {"Scene": "warp_caustics.scene", "CausticSimulator": "warp_caustics.simulator"}

__all__ = ["CausticSimulator", "Scene"]


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(importlib.import_module(_HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
