"""What one network says of an image: heights in each symmetry of the set-up, on the grid where they are refined."""

from collections.abc import Iterator

import torch

from nets.reconstruct.network_grid import NetworkGrid
from nets.reconstruct.told_bench import ToldBench
from nets.replayed import Replayed
from nets.shipped import FoundNetwork
from nets.symmetries import all_symmetries, seen_in, turned_back
from warp_caustics.reconstruct.base import CausticImage

SYMMETRIES_AT_ONCE = {"cpu": 4, "cuda": 8}
"""By device."""


class NetworkAnswers:
    """One network for one scene.

    A network that is told of its bench is told the scene. Images come to the network's grid and heights back to the
    scene's (:mod:`nets.reconstruct.network_grid`).

    Args:
        network: that serves the scene.
        device: where to compute.
        symmetries: look at an image in all of them, or as it is.

    Attributes:
        network: that answers.
        grid: of its pictures and heights.
        bench: what it is told; None where it is told nothing.
        symmetries: shape [3, B], the identity first.
    """

    def __init__(self, network: FoundNetwork, device: torch.device, symmetries: bool = True):
        self.network, self.device = network, device
        self.grid, seen = NetworkGrid(network, device), network.seen.scene
        is_told = bool(getattr(network.module, "is_told", False))
        self.bench = ToldBench(seen, network.info.scene, device) if is_told else None
        network.module.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.replayed = Replayed(network.module)
        found = all_symmetries(seen if self.bench is None else self.bench.trained)
        self.symmetries = found if symmetries else found[:, :1]

    @property
    def batches(self) -> int:
        """Into how many the symmetries are divided."""
        return -(-self.symmetries.shape[1] // SYMMETRIES_AT_ONCE[self.device.type])

    def __call__(self, image: CausticImage) -> Iterator[torch.Tensor]:
        """Heights of each symmetry turned back, batch by batch, shape [b, n, n] [m].

        Args:
            image: of the scene, at its exposure.
        """
        seen, noise = self.grid.picture(image), self.grid.noise(image)
        if self.bench is not None:
            seen = self.bench.picture(seen)
        for part in self.symmetries.split(SYMMETRIES_AT_ONCE[self.device.type], dim=1):
            told = [] if self.bench is None else [self.bench.told(noise, part)]
            heights = self.replayed(seen_in(seen, part), *told)
            if self.bench is not None:
                heights = heights * self.bench.height_scale
            yield self.grid.heights(turned_back(heights, part))
