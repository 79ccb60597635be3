"""Simulation for training: no checks that would make the CPU wait for the GPU, photons that vary by the step."""

import bisect
import itertools
from collections.abc import Sequence
from typing import Any

import torch

from nets.training.keys import step_seed
from nets.unrolling_config import PhotonVariant
from warp_caustics.data_gradient import possible_heights
from warp_caustics.many_scenes import ManyScenes
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator

BATCH_PIXELS = {"cpu": 2**23, "cuda": 2**27}
"""Image pixels simulated at a time."""


class Imager:
    """Images, and gradients of the data term, of whole batches.

    Args:
        scene: the set-up.
        photons: how to simulate.
        device: where.
    """

    def __init__(self, scene: Scene, photons: PhotonVariant, device: torch.device):
        self.scene = scene
        self.simulator = CausticSimulator(scene, device=device, **_options(scene, photons))
        self.is_random = photons.placement != "lattice"
        pixels = scene.n_wavelengths * scene.image_pixels**2
        self.batch = max(1, BATCH_PIXELS[device.type] // pixels)

    @torch.no_grad()
    def __call__(self, heights: torch.Tensor, seed: int = 0) -> torch.Tensor:
        """Irradiance, shape [B, n_w, m, m] [W/m^2], of finite heights [B, n, n] [m]; seed selects random photons."""
        if self.is_random:
            self.simulator.reseed(seed)
        return torch.cat([self.simulator.engine.image(part.contiguous()) for part in heights.split(self.batch)])

    @torch.no_grad()
    def with_gradient(self, heights: torch.Tensor, target: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Images, and the gradient of 1/2 sum_w mean_pixels (S(h) - I)^2 with respect to the heights.

        Args:
            heights: h [m], shape [B, n, n]; values that are no glass are replaced first.
            target: I [W/m^2], shape [B, n_w, m, m].

        Returns:
            S(h) [W/m^2], shape of target, and gradient [W^2/m^5], shape of heights.
        """
        heights = possible_heights(heights, self.scene)
        engine, pixels = self.simulator.engine, target.shape[-1] * target.shape[-2]
        images, gradients = [], []
        for part, seen in zip(heights.split(self.batch), target.split(self.batch), strict=True):
            part = part.contiguous()
            images.append(engine.image(part))
            gradients.append(engine.image_adjoint(part, ((images[-1] - seen) / pixels).contiguous()))
        return torch.cat(images), torch.cat(gradients)


class BenchImager:
    """Images of whole batches of plates, each on a bench of its own, all from the same photons.

    Args:
        scene: gives plate, grids and number of wavelengths.
        photons: how to simulate.
        device: where.
    """

    def __init__(self, scene: Scene, photons: PhotonVariant, device: torch.device):
        self.screens = ManyScenes(scene, device=device, **_options(scene, photons))
        self.is_random = photons.placement != "lattice"
        self.batch = max(1, BATCH_PIXELS[device.type] // (scene.n_wavelengths * scene.image_pixels**2))

    @torch.no_grad()
    def __call__(self, heights: torch.Tensor, scenes: Sequence[Scene], seed: int = 0) -> torch.Tensor:
        """Irradiance on the screens, shape [B, n_w, m, m] [W/m^2], of heights [B, n, n] [m]."""
        if self.is_random:
            self.screens.simulator.reseed(seed)
        starts = range(0, len(scenes), self.batch)
        return torch.cat([self.screens(heights[k : k + self.batch], scenes[k : k + self.batch]) for k in starts])


def _options(scene: Scene, photons: PhotonVariant) -> dict[str, Any]:
    """Of :class:`CausticSimulator`."""
    return {
        "preset": "lattice",
        "n_photons": max(1, round(photons.photons_per_pixel * scene.image_pixels**2)),
        "smoothing": photons.smoothing,
        "placement": photons.placement,
    }


class Variants:
    """Which photons a step takes.

    Args:
        variants: what to choose from, with their shares.
        seed: of the run.
    """

    def __init__(self, variants: tuple[PhotonVariant, ...], seed: int):
        self.seed = seed
        self.used = [variant for variant in variants if variant.share > 0]
        self.bounds = list(itertools.accumulate(variant.share for variant in self.used))

    def choice(self, step: int, rank: int) -> int:
        """Number of the variant that a step takes."""
        unit = step_seed(self.seed, "photon variant", step, rank) / 2**63
        return min(bisect.bisect_right(self.bounds, unit * self.bounds[-1]), len(self.bounds) - 1)

    def photons(self, step: int, rank: int) -> int:
        """Seed of a step's photons, where they are random."""
        return step_seed(self.seed, "photons", step, rank)


class VariedBenchImager(Variants):
    """Images of plates on benches by one of several variants; arguments as of :class:`VariedImager`."""

    def __init__(self, scene: Scene, variants: tuple[PhotonVariant, ...], seed: int, device: torch.device):
        super().__init__(variants, seed)
        self.imagers = [BenchImager(scene, variant, device) for variant in self.used]

    def __call__(self, heights: torch.Tensor, scenes: Sequence[Scene], step: int, rank: int) -> torch.Tensor:
        """Irradiance, shape [B, n_w, m, m] [W/m^2], of heights [B, n, n] [m]."""
        return self.imagers[self.choice(step, rank)](heights, scenes, self.photons(step, rank))


class VariedImager(Variants):
    """Images by one of several variants, chosen by the step.

    Args:
        scene: the set-up.
        variants: what to choose from, with their shares.
        seed: of the run.
        device: where.
    """

    def __init__(self, scene: Scene, variants: tuple[PhotonVariant, ...], seed: int, device: torch.device):
        super().__init__(variants, seed)
        self.imagers = [Imager(scene, variant, device) for variant in self.used]

    def __call__(self, heights: torch.Tensor, step: int, rank: int) -> torch.Tensor:
        """Irradiance, shape [B, n_w, m, m] [W/m^2], of heights [B, n, n] [m]."""
        return self.imagers[self.choice(step, rank)](heights, self.photons(step, rank))
