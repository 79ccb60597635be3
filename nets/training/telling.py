"""What a network in training is told of its benches: the truth with errors, some of it or all of it unknown.

Drawn anew for every visit of a sample, on the device.
"""

import math
from typing import NamedTuple

import torch

from nets.told import CAMERA, ToldTable, turned
from nets.training.camera import Camera
from nets.training.told_config import ToldConfig

LIGHT = ("light", "divergence", "lamp")
"""Groups of parameters that say where light comes from."""
CAMERA_GROUPS = ("blur", "noise")
"""Of the camera."""
AMOUNTS = ("gap", "divergence", "lamp", "blur", "noise")
"""Groups of parameters that nobody tells below 0."""


class Telling(NamedTuple):
    """Of a batch."""

    values: torch.Tensor
    """What is told, shape [B, P], SI units."""
    known: torch.Tensor
    """Whether it is told, 1 or 0, shape [B, P]."""


def with_camera(bench: torch.Tensor, camera: Camera | None) -> torch.Tensor:
    """Parameters of benches with those of their cameras, shape [B, P - 2] -> [B, P].

    Args:
        bench: of the scenes.
        camera: of each; None for perfect ones.
    """
    if camera is None:
        return torch.cat((bench, torch.zeros_like(bench[:, : len(CAMERA)])), dim=1)
    return torch.cat((bench, camera.blur.mean(dim=1, keepdim=True), camera.noise[:, None]), dim=1)


class Teller:
    """Draws what is told.

    Args:
        config: how wrong it may be, and how often it is unknown.
        table: of the network.
    """

    def __init__(self, config: ToldConfig, table: ToldTable):
        self.config, self.table = config, table
        device = table.centre.device
        absolute, relative = config.absolute(), config.relative()
        # The dispersion's error is one of all wavelengths.
        kinds = ["dispersion" if row.name.startswith("dispersion") else row.group for row in table.rows]
        self.absolute = torch.tensor([absolute.get(kind, 0.0) for kind in kinds], device=device)
        self.relative = torch.tensor([relative.get(kind, 0.0) for kind in kinds], device=device)
        alike = [kinds.index(kind) if kind == "dispersion" else place for place, kind in enumerate(kinds)]
        self.alike = torch.tensor(alike, device=device)
        unknown = [config.unknown_camera_share if g in CAMERA_GROUPS else config.unknown_share for g in table.groups]
        self.unknown_share = torch.tensor(unknown, device=device)
        self.is_light = torch.tensor([row.group in LIGHT for row in table.rows], device=device)
        self.log_care = tuple(math.log(end) for end in config.care)
        self.is_amount = torch.tensor([kind in AMOUNTS for kind in kinds], device=device)
        self.groups = len(table.groups)

    def drawn(self, true: torch.Tensor, generator: torch.Generator) -> Telling:
        """What is told of benches.

        Args:
            true: their parameters, shape [B, P], SI units.
            generator: on their device.
        """
        config, table = self.config, self.table

        def unit(*shape: int) -> torch.Tensor:
            return torch.rand(*shape, generator=generator, device=true.device)

        count = len(true)
        normal = torch.randn(true.shape, generator=generator, device=true.device)[:, self.alike]
        inexact = (unit(count, 1) >= config.exact_share).float()
        low, high = self.log_care
        care = (low + (high - low) * unit(count, 1)).exp()
        error = (self.absolute + self.relative * true) * normal * inexact * care
        is_unsaid = (unit(count, 1) < config.unsaid_lamp_share) & self.is_light
        unknown = (unit(count, self.groups) < self.unknown_share)[:, table.group]
        nothing = unit(count, 1) < config.nothing_share
        told = true + error
        told = torch.where(self.is_amount, told.clamp(min=0.0), told)
        told = torch.where(is_unsaid, table.centre, told)
        return Telling(told, (~(unknown | nothing)).float())

    def turned(self, bench: torch.Tensor, symmetries: torch.Tensor) -> torch.Tensor:
        """Parameters of turned benches, shape [B, P - 2]."""
        return turned(bench, symmetries, self.table)
