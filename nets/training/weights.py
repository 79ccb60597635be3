"""Weights files that a run begins with, uses or writes."""

from pathlib import Path
from typing import Any, cast

import torch
from torch import nn

from data_gen.samples import Denoiser
from nets.architecture import Architecture
from nets.direct_net import DirectNet
from nets.family import family_of
from nets.residual_config import DirectConfig
from nets.training.config import RunConfig
from nets.training.devices import autocast
from nets.training.keys import fresh_dataset
from nets.unrolled_net import UnrolledUpdater, warm_start
from warp_caustics.errors import MismatchError
from warp_caustics.scene import Scene


def export_weights(path: Path, network: nn.Module, config: RunConfig, training: dict[str, Any]) -> str:
    """Write the averaged network; returns the path.

    What it started from is recorded by its content hash, and by every training that made it (``legs_before``). Names of
    files in the record lose their folders.
    """
    from nets.training.origin import legs_before
    from nets.weights import save_weights, weights_info

    if config.initial_weights is not None:
        start = weights_info(config.initial_weights)
        training = {**training, "initial_weights": start.content_hash, "legs_before": legs_before(start)}
    if config.data is None:
        denoiser = frozen_denoiser(config, torch.device("cpu"))[1]
        fingerprint = fresh_dataset(config, is_validation=False, denoiser=denoiser).sample_fingerprint()
    else:
        from nets.training.files import data_fingerprint

        fingerprint = data_fingerprint(config.data)
    training = {
        **training,
        "config": config.training.model_dump(mode="json"),
        "reliefs": config.reliefs.model_dump(mode="json"),
    }
    if config.training.bench is not None:
        training["family"] = family_of(config.scene, config.training.bench, config.training.scene_share)
    without_folders(training["config"])
    precision = config.training.exported
    save_weights(path, network, scene=config.scene, data_fingerprint=fingerprint, training=training, dtype=precision)
    return str(path)


def without_folders(settings: dict[str, Any]) -> None:
    """Cut the names of weights files in a training's settings to their last part, in place."""
    for tree, key in ((settings, "denoiser_weights"), (settings["unrolling"], "direct_weights")):
        if tree[key] is not None:
            tree[key] = Path(tree[key]).name


def load_initial_weights(path: str, network: nn.Module, scene: Scene, *, starts_flat: bool) -> None:
    """Start from a weights file, also of a network that has less.

    An unrolled network may start from a direct one, a told one from one that is not, one with
    feedback from one without.

    Args:
        path: of the file.
        network: changed in place.
        scene: what it is for.
        starts_flat: of an unrolled network, whether no iteration starts at the direct network's answer.

    Raises:
        MismatchError: of another network.
    """
    from nets.weights import load_weights

    loaded = load_weights(path, scene=scene)
    if isinstance(network, UnrolledUpdater) and isinstance(loaded.module, DirectNet):
        warm_start(network, loaded.module, keep_head=starts_flat)
        return
    found, wanted = loaded.info.architecture, cast(Architecture, network.config)
    if found != wanted and found in _lesser(wanted):
        # What it is told or given changes nothing yet, so it answers as before.
        network.load_state_dict(loaded.module.state_dict(), strict=False)
        return
    if found != wanted:
        raise MismatchError(
            f"network in {path!r} is a {found.kind} of another architecture than the one to be trained; "
            "choose its preset, or leave out --initial-weights"
        )
    network.load_state_dict(loaded.module.state_dict())


def _lesser(architecture: Architecture) -> list[Architecture]:
    """The architecture without feedback; without weights for what it is told; and told nothing at all."""
    if not isinstance(architecture, DirectConfig):
        return []
    once = architecture.model_copy(update={"feedback": False})
    nothing = once.backbone.model_copy(update={"conditions": 0})
    by_picture = {"told_by": "picture"} if once.backbone.conditions else {}
    return [
        once,
        once.model_copy(update=by_picture),
        once.model_copy(update={"backbone": nothing, "told_by": "film"}),
    ]


def frozen_denoiser(config: RunConfig, device: torch.device) -> tuple[Denoiser | None, str | None]:
    """The network that denoises simulated images, and its content hash.

    Raises:
        MismatchError: the file holds another kind of network.
    """
    path = config.training.denoiser_weights
    if path is None:
        return None, None
    from nets.weights import load_weights

    loaded = load_weights(path, map_location=device)
    if loaded.info.architecture.kind != "denoiser":
        raise MismatchError(f"{path!r} holds a {loaded.info.architecture.kind} network; give a denoiser")
    network: Any = loaded.module.requires_grad_(False)
    if config.training.compile:
        network = torch.compile(network)

    def denoised(images: torch.Tensor) -> torch.Tensor:
        with autocast(config.training.precision, device):
            answer: torch.Tensor = network(images)
        return answer

    return denoised, loaded.info.content_hash


def frozen_direct_network(config: RunConfig, device: torch.device) -> Any:
    """The network whose answers unrolled training starts from; None where it starts from none.

    Raises:
        MismatchError: the file holds another kind of network, or one for another scene.
    """
    options = config.training.unrolling
    if not options.start.direct:
        return None
    from nets.weights import load_weights

    path = options.direct_weights or ""
    loaded = load_weights(path, scene=config.scene, map_location=device)
    if loaded.info.architecture.kind != "direct":
        raise MismatchError(f"{path!r} holds a {loaded.info.architecture.kind} network; give a direct one")
    return loaded.module.requires_grad_(False)
