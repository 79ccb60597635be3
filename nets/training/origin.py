"""Where a training comes from: code, time, licence, devices, and the trainings before it that it started from."""

import importlib.metadata
import subprocess
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import nets
from nets.weights import WeightsInfo
from warp_caustics.device import device_name

_GIT_SECONDS = 10.0

LEG = ("kind", "steps", "batch", "elapsed_s", "objective", "best", "config", "reliefs", "origin")
"""What is kept of an earlier training."""


def origin(device: str, processes: int) -> dict[str, Any]:
    """Date, commit, licence and devices of a training that ends now.

    Args:
        device: of this process.
        processes: how many trained together.
    """
    return {
        "date": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        "commit": commit(),
        "licence": importlib.metadata.metadata("nsfc").json.get("license_expression"),
        "device": device_name(device),
        "devices": processes,
    }


def commit() -> str | None:
    """Commit of the checkout that this code runs from, ``+`` behind it if files were changed; None outside of one."""
    (package,) = map(Path, nets.__path__)
    root = package.parent
    if not (root / ".git").exists():
        return None
    found = _git(root, "rev-parse", "HEAD")
    changed = _git(root, "status", "--porcelain", "--untracked-files=no")
    return None if found is None else found + ("+" if changed else "")


def legs_before(start: WeightsInfo) -> list[Mapping[str, Any]]:
    """Trainings that made the weights which another one starts from, the first one first.

    Files of earlier versions name the hash of what they started from and no more.
    """
    training = start.training
    legs = list(training.get("legs_before", ()))
    if not legs and "initial_weights" in training:
        legs = [{"content_hash": training["initial_weights"], "note": "its file is from before legs were recorded"}]
    leg = {name: training[name] for name in LEG if name in training}
    return [*legs, {"content_hash": start.content_hash, "data_fingerprint": start.data_fingerprint, **leg}]


def _git(root: Path, *arguments: str) -> str | None:
    try:
        done = subprocess.run(
            ["git", "-C", str(root), *arguments], capture_output=True, text=True, timeout=_GIT_SECONDS, check=True
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()
