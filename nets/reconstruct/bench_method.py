"""What a search for the bench asks of a method."""

from typing import Protocol, Self

import torch

from nets.reconstruct.refinement import Refinement
from nets.shipped import FoundNetwork
from warp_caustics.reconstruct.base import CausticImage, ProgressCallback, Reconstruction
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator
from warp_caustics.types import FloatArray


class BenchMethod(Protocol):
    """A network with its refinement on one bench, which can be taken to another."""

    scene: Scene
    device: torch.device
    network: FoundNetwork
    refinement: Refinement
    far: tuple[CausticImage, dict[str, float] | None] | None
    """The image of which the next search need not look for a far start (:mod:`~nets.reconstruct.far_pictures`), and
    that start; taken once, for an image may be changed."""

    def on_bench(self, scene: Scene) -> Self:
        """The same on another bench.

        Raises:
            CausticsError: it serves none such.
        """

    def answer(self, image: CausticImage) -> FloatArray:
        """Heights of the network before they are refined [m], shape [n, n]."""

    def found(
        self, image: CausticImage, initial: FloatArray | None = None, progress: ProgressCallback | None = None
    ) -> Reconstruction:
        """Heights refined on this bench, with their record."""

    def simulator_of(self, found: Reconstruction) -> CausticSimulator:
        """Of this bench, with the losses of light that were found."""
