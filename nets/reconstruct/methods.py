"""All reconstruction methods by name: those without networks, those with, and ``auto``."""

from collections.abc import Mapping
from typing import Any

import torch

from nets.reconstruct.auto import Auto
from nets.reconstruct.direct import Direct
from nets.reconstruct.direct_options import DirectOptions
from nets.reconstruct.fibres.method import Fibres
from nets.reconstruct.fibres.options import FibresOptions
from nets.reconstruct.nsfc import Nsfc, NsfcOptions
from nets.reconstruct.unrolled import NsfcUnrolled, UnrolledOptions
from warp_caustics.reconstruct.base import Reconstructor
from warp_caustics.reconstruct.methods import METHODS, Maker, create_from
from warp_caustics.scene import Scene


def _auto(scene: Scene, options: Mapping[str, Any], device: str | torch.device) -> Reconstructor:
    return Auto(scene, options, device, create)


def _direct(scene: Scene, options: Mapping[str, Any], device: str | torch.device) -> Reconstructor:
    return Direct(scene, DirectOptions(**options), device)


def _fibres(scene: Scene, options: Mapping[str, Any], device: str | torch.device) -> Reconstructor:
    return Fibres(scene, FibresOptions(**options), device)


def _nsfc(scene: Scene, options: Mapping[str, Any], device: str | torch.device) -> Reconstructor:
    return Nsfc(scene, NsfcOptions(**options), device)


def _unrolled(scene: Scene, options: Mapping[str, Any], device: str | torch.device) -> Reconstructor:
    return NsfcUnrolled(scene, UnrolledOptions(**options), device)


ALL_METHODS: dict[str, Maker] = {
    "auto": _auto,
    "direct": _direct,
    "fibres": _fibres,
    "nsfc": _nsfc,
    "nsfc-unrolled": _unrolled,
    **METHODS,
}
"""Makers of all methods by name."""

SEEDED = ("nsfc", "nsfc-unrolled")
"""Methods with an option ``seed``."""


def create(name: str, scene: Scene, *, device: str | torch.device = "cpu", **options: Any) -> Reconstructor:
    """The reconstruction method of that name.

    Args:
        name: one of :data:`ALL_METHODS`.
        scene: the set-up of the measurement.
        device: where to compute.
        options: the method's own settings.

    Raises:
        InputError: unknown method or option, or weights that are missing.
        MismatchError: weights for another scene.
        ResourceError: the device is missing.
    """
    return create_from(ALL_METHODS, name, scene, device, options)
