"""What a network is told as planes beside its picture: numbers that are the same everywhere, and light that is not.

Another way than to scale channels (:class:`nets.backbone.Film`); ``network.told_by`` chooses.
"""

import torch
from torch import nn

from nets.backbone import zeroed
from nets.encoding import full_precision
from nets.told import told_parameters
from warp_caustics.scene import Scene

LIGHT = 2
"""Planes of the light's tangent, along x and y."""


class ToldMaps(nn.Module):
    """What is told as input planes, through weights that start as nothing; always in float32.

    Each number is a plane of its own, and so is each 1 or 0 of what is known. Two more say under which angle light
    meets each height sample: t + x / D less that of the network's own scene, in the unit of t, which numbers alone
    leave to be worked out at every place. Nothing told is zeros.

    Added to what the picture's planes become, which is one convolution of all planes together.

    Args:
        scene: that the network is made for; gives plate, samples and what can be told.
        channels: that the planes become.
    """

    along_x: torch.Tensor
    along_y: torch.Tensor

    def __init__(self, scene: Scene, channels: int):
        super().__init__()
        rows = told_parameters(scene)
        places = {row.name: (place, row.scale) for place, row in enumerate(rows)}
        (self.x, unit), (self.y, _) = places["light_x"], places["light_y"]
        self.divergence, divergence_unit = places["divergence_1_m"]
        self.samples = scene.height_samples
        centres = (torch.arange(self.samples) + 0.5) / self.samples - 0.5
        for name, size in zip(("along_x", "along_y"), scene.plate_size_m, strict=True):
            self.register_buffer(name, centres * size * divergence_unit / unit, persistent=False)
        self.weighted = zeroed(nn.Conv2d(2 * len(rows) + LIGHT, channels, 3, padding=1, bias=False))

    def forward(self, told: torch.Tensor) -> torch.Tensor:
        """Shape [B, 2 P], as :func:`nets.told.dropped` gives it -> [B, channels, n, n]."""
        with full_precision(told):
            added: torch.Tensor = self.weighted(self.planes(told))
        return added

    def planes(self, told: torch.Tensor) -> torch.Tensor:
        """The planes themselves, shape [B, 2 P] -> [B, 2 P + 2, n, n]."""
        told, n = told.float(), self.samples
        divergence = told[:, self.divergence, None]
        along_x = told[:, self.x, None] + divergence * self.along_x
        along_y = told[:, self.y, None] + divergence * self.along_y
        everywhere = told[:, :, None, None].expand(-1, -1, n, n)
        light = (along_x[:, None, None, :].expand(-1, -1, n, n), along_y[:, None, :, None].expand(-1, -1, n, n))
        return torch.cat((everywhere, *light), dim=1)
