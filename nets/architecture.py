"""Networks by name or configuration: what ``nsfc train`` and weights files build."""

import math
from collections.abc import Callable
from typing import Annotated, Any

import pydantic
import torch
from pydantic import Field
from torch import nn

from nets.config import FAMILY_PRESETS, DenoiserConfig, NetworkConfig, UpdaterConfig
from nets.denoiser import Denoiser
from nets.direct_net import DirectNet
from nets.residual_config import RESIDUAL_PRESETS, DirectConfig, UnrolledConfig
from nets.unrolled_net import UnrolledUpdater
from nets.updater import Updater
from warp_caustics.errors import InputError
from warp_caustics.scene import Scene, validation_lines

Architecture = DenoiserConfig | UpdaterConfig | DirectConfig | UnrolledConfig

PRESETS: dict[str, Architecture] = {**FAMILY_PRESETS, **RESIDUAL_PRESETS}

MAX_PARAMETERS = 2**29
"""2 GiB of float32, four times that in training. Corners of Tab. 2's ranges reach 10^11."""

_ARCHITECTURE: pydantic.TypeAdapter[Architecture] = pydantic.TypeAdapter(
    Annotated[Architecture, Field(discriminator="kind")]
)


def build(source: str | Architecture | NetworkConfig, scene: Scene) -> nn.Module:
    """A fresh network.

    Args:
        source: name of a preset, an architecture, or numbers of Tab. 2 (an updater where they have output
            blocks, a denoiser otherwise).
        scene: what it is for.

    Returns:
        The network, float32, in training mode; its ``config`` is the complete architecture.

    Raises:
        InputError: unknown name, too many parameters, or image and heights of a scene that do not fit.
    """
    architecture = resolve(source)
    shapes(architecture, scene)  # refuses what would not fit into memory
    return _made(architecture, scene)


def resolve(source: str | Architecture | NetworkConfig) -> Architecture:
    """The architecture that :func:`build` means.

    Raises:
        InputError: unknown name.
    """
    if isinstance(source, str):
        if source not in PRESETS:
            raise InputError(f"network {source!r} is not known; use one of {', '.join(PRESETS)}")
        return PRESETS[source]
    if isinstance(source, NetworkConfig):
        try:
            return UpdaterConfig(network=source) if source.m_dec is not None else DenoiserConfig(network=source)
        except pydantic.ValidationError as error:
            raise InputError("; ".join(validation_lines(error))) from error
    return source


def parse_architecture(record: Any) -> Architecture:
    """An architecture from its record, as ``model_dump(mode="json")`` writes it.

    Raises:
        InputError: no such architecture.
    """
    try:
        return _ARCHITECTURE.validate_python(record)
    except pydantic.ValidationError as error:
        raise InputError("; ".join(validation_lines(error)[:3])) from error


def architecture_record(architecture: Architecture) -> dict[str, Any]:
    """JSON values of an architecture, without what is off or by default, as older programs know it."""
    tree = architecture.model_dump(mode="json")
    if not tree.get("feedback", True):
        del tree["feedback"]
    if tree.get("told_by") == "film":
        del tree["told_by"]
    if not tree.get("backbone", {}).get("conditions", 1):
        del tree["backbone"]["conditions"]
    return tree


def shapes(architecture: Architecture, scene: Scene) -> dict[str, tuple[int, ...]]:
    """Names and shapes of a network's weights, found without allocating them.

    Raises:
        InputError: too many parameters, or image and heights of the scene do not fit.
    """
    with torch.device("meta"):
        found = {key: tuple(tensor.shape) for key, tensor in _made(architecture, scene).state_dict().items()}
    count = sum(map(math.prod, found.values()))
    if count > MAX_PARAMETERS:
        raise InputError(
            f"network would have {count:.2g} parameters, the limit is {MAX_PARAMETERS:.2g}; "
            "lower channels, multiplier, depth or kernels"
        )
    return found


def parameter_count(source: str | Architecture | NetworkConfig, scene: Scene) -> int:
    """Number of learned values of a network that is not built.

    Raises:
        InputError: as :func:`build`.
    """
    return sum(map(math.prod, shapes(resolve(source), scene).values()))


_MAKERS: dict[str, Callable[[Any, Scene], nn.Module]] = {
    "denoiser": lambda config, scene: Denoiser(config),
    "updater": Updater,
    "direct": DirectNet,
    "unrolled": UnrolledUpdater,
}


def _made(architecture: Architecture, scene: Scene) -> nn.Module:
    return _MAKERS[architecture.kind](architecture, scene)
