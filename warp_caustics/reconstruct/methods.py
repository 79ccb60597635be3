"""Reconstruction methods without networks by name; :func:`nets.create` makes all."""

from collections.abc import Callable, Mapping
from typing import Any

import pydantic
import torch

from warp_caustics.errors import InputError, known_names
from warp_caustics.reconstruct.base import Reconstructor
from warp_caustics.reconstruct.refine.options import RefineOptions
from warp_caustics.reconstruct.refine.refine import Refine
from warp_caustics.reconstruct.sfc.options import SfcOptions
from warp_caustics.reconstruct.sfc.sfc import Sfc
from warp_caustics.reconstruct.transport.hcccd import Hcccd, HcccdOptions
from warp_caustics.reconstruct.transport.transport import Transport, TransportOptions
from warp_caustics.scene import Scene, validation_lines


def _refine(scene: Scene, options: Mapping[str, Any], device: str | torch.device) -> Reconstructor:
    return Refine(scene, RefineOptions(**options), device)


def _sfc(scene: Scene, options: Mapping[str, Any], device: str | torch.device) -> Reconstructor:
    return Sfc(scene, SfcOptions(**options), device)


def _transport(scene: Scene, options: Mapping[str, Any], device: str | torch.device) -> Reconstructor:
    return Transport(scene, TransportOptions(**options), device)


def _hcccd(scene: Scene, options: Mapping[str, Any], device: str | torch.device) -> Reconstructor:
    return Hcccd(scene, HcccdOptions(**options), device)


Maker = Callable[[Scene, Mapping[str, Any], str | torch.device], Reconstructor]
"""Scene, options and device to method."""

METHODS: dict[str, Maker] = {
    "refine": _refine,
    "sfc": _sfc,
    "transport": _transport,
    "hcccd": _hcccd,
}


def create_from(
    methods: Mapping[str, Maker], name: str, scene: Scene, device: str | torch.device, options: Mapping[str, Any]
) -> Reconstructor:
    """The method of that name from a registry.

    Args:
        methods: makers by name.
        name: one of them.
        scene: the set-up of the measurement.
        device: where to compute.
        options: the method's own settings.

    Raises:
        InputError: unknown method or option.
        ResourceError: the device is missing.
    """
    if name not in methods:
        raise InputError(f"method {name!r} is not known; {known_names(name, methods)}")
    try:
        return methods[name](scene, options, device)
    except pydantic.ValidationError as error:
        raise InputError("; ".join(validation_lines(error, name))) from error
