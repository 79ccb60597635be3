"""What one network says of an image: heights in each symmetry of the set-up, on the grid where they are refined."""

import copy
import dataclasses
from collections.abc import Iterator
from typing import NamedTuple, Self

import torch

from nets.family import check_family
from nets.reconstruct.network_grid import NetworkGrid
from nets.reconstruct.told_bench import ToldBench
from nets.replayed import Replayed
from nets.seen_scene import seen_scene
from nets.shipped import FoundNetwork
from nets.symmetries import all_symmetries, seen_in, turned_back
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.scene import Scene

SYMMETRIES_AT_ONCE = {"cpu": 4, "cuda": 8}
"""By device."""


class Look(NamedTuple):
    """An answer that is there already, as a network with feedback is given it."""

    answer: torch.Tensor
    """In the network's own unit, shape [n', n'] of its own samples [m]."""
    echo: torch.Tensor
    """Its caustic as the network sees images, shape [n_w, m', m'] of its own pixels [W/m^2]."""


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
        bench: what it is told, or what its picture is freed of; None where that is its own.
        is_told: whether it is told.
        has_feedback: whether it can look again at an answer.
        symmetries: shape [3, B], the identity first.
    """

    def __init__(self, network: FoundNetwork, device: torch.device, symmetries: bool = True):
        self.network, self.device = network, device
        self.grid, seen = NetworkGrid(network, device), network.seen.scene
        self.is_told = bool(getattr(network.module, "is_told", False))
        self.has_feedback = bool(getattr(network.module, "has_feedback", False))
        self.bench = ToldBench(seen, network.info.scene, device) if self.is_told else None
        network.module.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.replayed = Replayed(network.module)
        found = all_symmetries(seen if self.bench is None else self.bench.trained)
        self.symmetries = found if symmetries else found[:, :1]

    def on_bench(self, scene: Scene) -> Self:
        """The same network on another bench near its own: as many pixels, samples and wavelengths.

        A network that is told of its bench is told of this one. Another one sees the picture as its own bench would
        have shown it: a flat plate's light where it met the plate, and heights in proportion, which is right to first
        order (:mod:`nets.flat_light`); refinement does the rest.

        Raises:
            MismatchError: a bench beyond the family of a network that is told of it.
        """
        trained = self.network.info.scene
        seen = seen_scene(scene, trained)
        if self.network.is_told:  # of a file that tells no family, none is known to end
            check_family(seen, trained, self.network.info.training["family"], self.network.file, "direct")
        other = copy.copy(self)
        other.network = dataclasses.replace(self.network, seen=seen)
        other.grid = NetworkGrid(other.network, self.device)
        other.bench = ToldBench(seen.scene, trained, self.device)
        is_all = self.symmetries.shape[1] > 1
        other.symmetries = all_symmetries(trained)[:, : None if is_all else 1]
        return other

    @property
    def batches(self) -> int:
        """Into how many the symmetries are divided."""
        return -(-self.symmetries.shape[1] // SYMMETRIES_AT_ONCE[self.device.type])

    def __call__(self, image: CausticImage, look: Look | None = None) -> Iterator[torch.Tensor]:
        """Heights of each symmetry turned back, batch by batch, shape [b, n, n] [m].

        Args:
            image: of the scene, at its exposure.
            look: at an answer that is there already, by a network with feedback; None for a first look.
        """
        seen, noise = self._picture(image), self.grid.noise(image)
        for part in self.symmetries.split(SYMMETRIES_AT_ONCE[self.device.type], dim=1):
            given = [self.bench.told(noise, part)] if self.bench is not None and self.is_told else []
            given += [seen_in(each, part) for each in look] if look is not None else []
            heights = self.replayed(seen_in(seen, part), *given)
            if self.bench is not None:
                heights = heights * self.bench.height_scale
            yield self.grid.heights(turned_back(heights, part))

    def look(self, heights: torch.Tensor, caustic: torch.Tensor) -> Look:
        """What the network is given to look again.

        Args:
            heights: an answer, of any network [m], shape [n, n].
            caustic: of these heights on the scene, shape [n_w, m, m] [W/m^2].
        """
        answer = self.grid.answer(heights.to(self.device, torch.float32)[None])[0]
        scale = 1.0 if self.bench is None else self.bench.height_scale
        return Look(answer / scale, self._picture(CausticImage(caustic.cpu().numpy())))

    def _picture(self, image: CausticImage) -> torch.Tensor:
        """An image as the network sees it, shape [n_w, m', m'] of its own pixels."""
        seen = self.grid.picture(image)
        return seen if self.bench is None else self.bench.picture(seen)
