"""Networks that come with the software, and how a method finds the one it needs."""

import copy
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import torch
from torch import nn

from nets.architecture import Architecture
from nets.fitting_network import Fit, Fitting, is_told
from nets.scene_match import train_command
from nets.seen_scene import SeenScene
from nets.weights import LoadedNetwork, WeightsInfo, load_weights, weights_info
from warp_caustics.errors import InputError, MismatchError
from warp_caustics.scene import Scene

FOLDER = Path(__file__).parent / "trained"

FEWEST_STEPS = 1000
"""Weights of fewer training steps are named as such wherever they are used; those that ship have 1,136 to 14,000."""


@dataclass(frozen=True)
class FoundNetwork:
    """A network that fits a scene.

    Attributes:
        module: float32, in evaluation mode, on its device.
        info: what its file says of itself.
        file: name of the file.
        warnings: what the user should know.
        seen: the scene as the network sees it.
    """

    module: nn.Module
    info: WeightsInfo
    file: str
    warnings: tuple[str, ...]
    seen: SeenScene

    @property
    def record(self) -> dict[str, Any]:
        """Which network it was, for a result's settings; and what was resampled and scaled for it, if anything was."""
        found = {"file": self.file, "kind": self.info.architecture.kind, "content_hash": self.info.content_hash}
        return {**found, "sees": self.seen.record} if self.seen.record else found

    @property
    def is_told(self) -> bool:
        """Whether it is told of its bench."""
        return is_told(self.info)

    @property
    def few_steps(self) -> int | None:
        """Steps of its training where they are too few to rely on; None where they are enough or not on record."""
        return few_steps(self.info)

    @property
    def training(self) -> dict[str, Any]:
        """Configuration of its training; empty where the file does not tell."""
        config = self.info.training.get("config")
        return dict(config) if isinstance(config, dict) else {}

    @property
    def pixels_of_one(self) -> float:
        """The scene's pixels per side over the network's."""
        return self.seen.working.image_pixels / self.info.scene.image_pixels

    @property
    def trained_shift_px(self) -> float | None:
        """How far apart channels were in training [px of the scene]; None where the file does not tell."""
        camera = self.training.get("camera")
        shift = camera.get("shift_px") if isinstance(camera, dict) else None
        return None if shift is None else float(shift) * self.pixels_of_one


def few_steps(info: WeightsInfo) -> int | None:
    """Steps of a training if they are fewer than ``FEWEST_STEPS``; None otherwise, or if the file does not tell."""
    steps = info.training.get("steps")
    return steps if isinstance(steps, int) and steps < FEWEST_STEPS else None


def shipped_weights() -> list[Path]:
    """Weights files that come with the software."""
    return sorted(FOLDER.glob("*.safetensors"))


def shipped_start(architecture: Architecture) -> str:
    """File of the shipped weights that a network may start from: one that is told of its bench from one that is, too.

    Raises:
        InputError: none ships.
    """
    kind = architecture.kind
    infos = {file: _info(file) for file in shipped_weights()}
    files = [file for file, info in infos.items() if info.architecture.kind == kind]
    for file in files:
        if infos[file].architecture == architecture:
            return str(file)
    if not files:
        raise InputError(f"no {kind} network comes with this software; give its weights as --initial-weights FILE")
    return str(next((file for file in files if not is_told(infos[file])), files[0]))


def shipped_steps(kind: str) -> int | None:
    """Steps that the longest training of a shipped network of that kind took; None where none ships."""
    infos = [_info(file) for file in shipped_weights()]
    steps = [int(info.training.get("steps", 0)) for info in infos if info.architecture.kind == kind]
    return max(steps, default=0) or None


def find_network(
    kind: str,
    scene: Scene,
    *,
    path: str | None = None,
    device: str | torch.device = "cpu",
    suits: Callable[[WeightsInfo], bool] | None = None,
    what: str | None = None,
    settings: Mapping[str, str] | None = None,
    any_grid: bool = False,
) -> FoundNetwork:
    """The network of a kind for a scene: from a file, or shipped.

    Args:
        kind: denoiser, updater, direct or unrolled.
        scene: what it shall be used for.
        path: file; None searches those that are shipped, where the fewest warnings win.
        device: where the network shall be.
        suits: tells whether a shipped network is the one that is meant; None takes the first.
        what: the network in words, for messages.
        settings: with which such a network is trained, for messages.
        any_grid: images and heights will be brought to the network's grid, and it will be told of the scene where it
            can be: other pixels, samples, plates and wavelengths will do, and any bench of its family.

    Raises:
        InputError: no such file, or none shipped.
        MismatchError: another kind of network, or only networks for other scenes.
        DamagedDataError: a file is not what was written.
    """
    what = what or f"{kind} network"
    fitting = Fitting(kind, scene, str(device), settings, any_grid=any_grid)
    if path is not None:
        info = _info(Path(path))
        if info.architecture.kind != kind:
            raise MismatchError(f"{path!r} holds a {info.architecture.kind} network, not a {kind}; give one")
        fit = fitting.fit(Path(path), info, repr(os.fspath(path)))
    else:
        infos = {file: _info(file) for file in shipped_weights()}
        infos = {f: i for f, i in infos.items() if i.architecture.kind == kind and (suits is None or suits(i))}
        if not infos:
            raise InputError(
                f"no {what} comes with this software; train one with: {train_command(kind, scene, settings)}, "
                "and name its weights.safetensors as --set reconstruction.options.weights=FILE"
            )
        fit = fitting.best(infos)
    warnings, few = fit.warnings, few_steps(_info(fit.file))
    if few is not None:
        warnings += (
            f"{kind} network {fit.name} was trained for {few} steps, fewer than {FEWEST_STEPS}: its answers are a "
            "guess, and no uncertainty is calibrated for them",
        )
    return _loaded(fit, warnings, device)


def told_network(
    kind: str, scene: Scene, first: FoundNetwork, device: str | torch.device = "cpu"
) -> FoundNetwork | None:
    """A shipped network that is told of the bench and serves a scene without a warning, beside one that was found.

    Args:
        kind: of network.
        scene: what it shall be used for, on any grid.
        first: that one; None comes of one that is told itself, and heights are those of its grid.
        device: where the network shall be.
    """
    if first.is_told:
        return None
    fitting = Fitting(kind, scene, str(device), any_grid=True)
    for file in shipped_weights():
        info = _info(file)
        if info.architecture.kind != kind or not is_told(info):
            continue
        try:
            fit = fitting.fit(file, info, f"shipped network {file.name!r}")
        except MismatchError:
            continue
        if not fit.warnings and few_steps(info) is None and fit.seen.working == first.seen.working:
            return _loaded(fit, (), device)
    return None


def _loaded(fit: Fit, warnings: tuple[str, ...], device: str | torch.device) -> FoundNetwork:
    kept = _kept_network(fit.file, _changed(fit.file))
    return FoundNetwork(_sharing(kept.module).to(device), kept.info, fit.file.name, warnings, fit.seen)


def _sharing(module: nn.Module) -> nn.Module:
    """The same network of the same weights in memory: who brings it elsewhere, or into another order, takes a copy.

    Modules are copied one by one; to look through all that they hold for what to copy takes a GPU's plate 0.1 s.
    """
    twin = copy.copy(module)
    twin.__dict__ |= {name: copy.copy(value) for name, value in vars(module).items() if isinstance(value, dict)}
    for name, weight in module.named_parameters(recurse=False):
        twin._parameters[name] = nn.Parameter(weight.detach(), requires_grad=False)
    for name, value in module.named_buffers(recurse=False):
        twin._buffers[name] = value.detach()
    for name, child in module.named_children():
        twin._modules[name] = _sharing(child)
    return twin


def _info(path: Path) -> WeightsInfo:
    return _cached_info(path, _changed(path))


def _changed(path: Path) -> int:
    """When a file was written; 0 where it cannot be told: what is wrong is said where it is read."""
    try:
        return path.stat().st_mtime_ns
    except OSError:
        return 0


@lru_cache(maxsize=32)
def _cached_info(path: Path, changed: int) -> WeightsInfo:
    return weights_info(path)


@lru_cache(maxsize=2)
def _kept_network(path: Path, changed: int) -> LoadedNetwork:
    """A network on the CPU: to read and check the two of a method takes 0.4 s, a fifth of all that a plate may take."""
    return load_weights(path)
