"""``nsfc-unrolled``: an updater trained on its own iterates, simulator in the loop, then refined on the exact model."""

from typing import Any, Literal

import torch

from nets.reconstruct.iteration import Iterated, IterationOptions, relative
from nets.replayed import Replayed
from nets.shipped import FoundNetwork, find_network
from nets.symmetries import all_symmetries, seen_in, turned_back
from nets.unrolled_net import Update
from nets.unrolling_config import UnrollingConfig
from warp_caustics.data_gradient import squares_gradient
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator, usable_device
from warp_caustics.types import FloatArray


class UnrolledOptions(IterationOptions):
    """Settings of ``nsfc-unrolled``."""

    start: Literal["auto", "flat", "direct"] = "auto"
    """Where to begin without a given relief; auto: at the direct network's answer if the training did."""
    direct_weights: str | None = None
    """Weights file of the direct network; None takes a shipped one."""
    symmetries: bool | None = None
    """Mean over all turns and flips; None: on a GPU only, since each is simulated in every step."""


class NsfcUnrolled(Iterated):
    """Updater with memory, from flat or from the direct network's answer.

    Args:
        scene: the set-up of the measurement.
        options: see :class:`UnrolledOptions`.
        device: where to compute.

    Raises:
        InputError: no such network is shipped, or no such file.
        MismatchError: a network is for another scene.
    """

    name = "nsfc-unrolled"
    options: UnrolledOptions

    def __init__(self, scene: Scene, options: UnrolledOptions | None = None, device: str | torch.device = "cpu"):
        options = options or UnrolledOptions()
        device = usable_device(device)
        network = find_network("unrolled", scene, path=options.weights, device=device)
        super().__init__(scene, options, network, device)
        self.training = UnrollingConfig.model_validate(network.training.get("unrolling", {}))
        self.direct: FoundNetwork | None = None
        if options.start == "direct" or (options.start == "auto" and self.training.start.direct > 0):
            self.direct = find_network("direct", scene, path=options.direct_weights, device=device)
        photons = self.training.photons
        self.inner = CausticSimulator(
            self.inner_scene,
            "lattice",
            n_photons=max(1, round(photons.photons_per_pixel * scene.image_pixels**2)),
            smoothing=photons.smoothing,
            placement=photons.placement,
            seed=options.seed,
            device=self.device,
        )
        is_averaged = self.device.type == "cuda" if options.symmetries is None else options.symmetries
        everything = all_symmetries(scene)
        self.symmetries = everything if is_averaged else everything[:, :1]

    @property
    def iterations(self) -> int:
        return self.options.max_iterations or self.training.last_steps

    @property
    def used(self) -> dict[str, Any]:
        return {
            "network": self.network.record,
            "direct": None if self.direct is None else self.direct.record,
            "copies": self.symmetries.shape[1],
            "photons": self.inner.settings(),
        }

    def start(self, target: torch.Tensor, initial: FloatArray | None) -> torch.Tensor:
        self.target = seen_in(target, self.symmetries)
        self.hidden: torch.Tensor | None = None
        if initial is not None:
            return seen_in(torch.as_tensor(initial, dtype=torch.float32, device=self.device), self.symmetries)
        if self.direct is not None:
            return Replayed(self.direct.module)(self.target)
        n = self.scene.height_samples
        return torch.zeros(len(self.target), n, n, device=self.device)

    def step(self, number: int, heights: torch.Tensor) -> tuple[torch.Tensor, float]:
        simulated, gradient = squares_gradient(self.inner, heights, self.target)
        with torch.inference_mode():
            update: Update = self.network.module(self.target, simulated, heights, gradient, self.hidden, number)
        self.hidden = None if update.hidden is None else update.hidden.clone()
        return update.heights.clone(), relative(simulated, self.target)

    def mean(self, heights: torch.Tensor) -> torch.Tensor:
        if len(heights) != self.symmetries.shape[1]:
            return heights[0]  # interrupted before the start was known
        return turned_back(heights, self.symmetries).mean(dim=0)
