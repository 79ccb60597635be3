"""Plates on benches of their own: a batch in which every relief has another scene.

Kernels take one scene per launch, so a batch is a launch for each relief. What a simulator is made of that costs time,
spline matrices and photons, depends on the plate and on grids alone and is shared; a scene's own numbers are a struct.
"""

from collections.abc import Sequence
from typing import Any

import torch

from warp_caustics.errors import InputError
from warp_caustics.optics import spectra_of
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator


class ManyScenes:
    """Simulates reliefs on benches of their own.

    Attributes:
        simulator: of the scene that all others have the plate's size and the numbers of samples, pixels and wavelengths
            from; its photons are those of all.
    """

    def __init__(self, scene: Scene, *, device: str | torch.device = "cpu", **photons: Any):
        """Prepare what all scenes share.

        Args:
            scene: one of them.
            device: where to simulate.
            photons: options of :class:`CausticSimulator`.
        """
        self.simulator = CausticSimulator(scene, device=device, **photons)

    @torch.no_grad()
    def __call__(
        self, heights: torch.Tensor, scenes: Sequence[Scene], seeds: Sequence[int] | None = None
    ) -> torch.Tensor:
        """Irradiance, shape [B, n_w, m, m] [W/m^2].

        Args:
            heights: [m], shape [B, n, n], finite, of the simulator's device and type.
            scenes: of each relief.
            seeds: of each relief's photons, where they are no lattice; None takes the same for all.

        Raises:
            InputError: not one scene per relief, or one of another plate or grid.
        """
        if len(scenes) != len(heights):
            raise InputError(f"{len(scenes)} scenes for {len(heights)} reliefs; give one each")
        for scene in scenes:
            self._check(scene)
        engine, dtype = self.simulator.engine, self.simulator.dtype
        if not scenes:
            return heights.new_empty(0, engine.scene.n_wavelengths, *(engine.scene.image_pixels,) * 2)
        table = torch.tensor([spectra_of(scene) for scene in scenes], dtype=dtype)
        if engine.device.type == "cuda":
            table = table.pin_memory().to(engine.device, non_blocking=True)
        images = []
        for row, (scene, spectra) in enumerate(zip(scenes, table, strict=True)):
            if seeds is not None and self.simulator.plan.placement != "lattice":
                self.simulator.reseed(seeds[row])
            images.append(engine.on(scene, spectra).image(heights[row : row + 1].contiguous()))
        return torch.cat(images)

    def _check(self, scene: Scene) -> None:
        shared = self.simulator.scene
        for name in ("plate_size_m", "height_samples", "image_pixels", "n_wavelengths"):
            mine, other = getattr(shared, name), getattr(scene, name)
            if mine != other:
                raise InputError(
                    f"a scene has {name} {other}, the others {mine}; benches of one batch share plate and grids, "
                    f"set scene.{name} to {mine}"
                )
