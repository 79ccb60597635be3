"""What was compared, and with what: enough to repeat it."""

import os
import platform
from collections.abc import Sequence
from typing import Any

import torch

from cli.provenance import now, versions
from nets.evaluation.code_version import code_version
from nets.evaluation.method_spec import MethodSpec
from nets.evaluation.schedule import Setup
from warp_caustics.far_screen import FAR_SCREEN_M


def about_comparison(setup: Setup, specs: Sequence[MethodSpec], budgets: Sequence[str], noise: float) -> dict[str, Any]:
    """Everything but the results."""
    return {
        "methods": [spec.label for spec in specs],
        "iterations": list(budgets),
        "fields": [
            {"name": field.name, "fold_fraction": field.folds, "image": field.origin, "warnings": field.warnings}
            for field in setup.fields.values()
        ],
        "noise": noise,
        "photons": setup.photons.model_dump(),
        "scene": setup.scene.model_dump(mode="json"),
        "picture_screen_m": FAR_SCREEN_M,
        "device": _device_name(setup.device),
        "versions": versions(),
        "code": code_version(),
        "created": now(),
    }


def _device_name(device: str) -> str:
    """What times were measured on."""
    if torch.device(device).type == "cuda":
        return torch.cuda.get_device_name(device)
    return f"{platform.machine()}, {len(os.sched_getaffinity(0))} cores"
