"""Plates on benches of their own: a batch in which every relief has another scene.

What a simulator is made of that costs time, spline matrices and photons, depends on the plate and on grids alone and is
shared; a scene's own numbers are a struct. On a GPU reliefs whose scenes have the same effects are one launch with a
struct for each; on a CPU each is a launch of its own, so that an image does not depend on its neighbours' number.
"""

from collections.abc import Sequence
from typing import Any

import torch

from warp_caustics.errors import InputError
from warp_caustics.kernels.effects import Effects
from warp_caustics.optics import effects_of, spectra_of
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator


class ManyScenes:
    """Simulates reliefs on benches of their own.

    Attributes:
        simulator: of the scene that all others have the plate's size and the numbers of samples, pixels and wavelengths
            from; its photons are those of all.
        at_once: reliefs with the same photons and effects are one launch.
    """

    def __init__(self, scene: Scene, *, device: str | torch.device = "cpu", **photons: Any):
        """Prepare what all scenes share.

        Args:
            scene: one of them.
            device: where to simulate.
            photons: options of :class:`CausticSimulator`.
        """
        self.simulator = CausticSimulator(scene, device=device, **photons)
        self.at_once = self.simulator.device.type == "cuda"

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
        m = engine.scene.image_pixels
        images = heights.new_empty(len(scenes), engine.scene.n_wavelengths, m, m)
        if not scenes:
            return images
        table = torch.tensor([spectra_of(scene) for scene in scenes], dtype=dtype)
        if engine.device.type == "cuda":
            table = table.pin_memory().to(engine.device, non_blocking=True)
        is_lattice = self.simulator.plan.placement == "lattice"
        for rows in self._launches(scenes, is_lattice or seeds is None):
            if seeds is not None and not is_lattice:
                self.simulator.reseed(seeds[rows[0]])
            some, spectra, reliefs = [scenes[row] for row in rows], table, heights
            if len(rows) < len(scenes):
                # A range is a view; a list would wait for the device.
                here = slice(rows[0], rows[0] + 1) if len(rows) == 1 else self._index(rows)
                spectra, reliefs = table[here], heights[here]
                images[here] = engine.on(some, spectra).image(reliefs.contiguous())
            else:
                images = engine.on(some, spectra).image(reliefs.contiguous())
        return images

    def _launches(self, scenes: Sequence[Scene], same_photons: bool) -> list[list[int]]:
        """Reliefs to simulate at once: those with the same effects, or each alone."""
        if not (self.at_once and same_photons):
            return [[row] for row in range(len(scenes))]
        groups: dict[Effects, list[int]] = {}
        for row, scene in enumerate(scenes):
            groups.setdefault(effects_of(scene), []).append(row)
        return list(groups.values())

    def _index(self, rows: list[int]) -> torch.Tensor:
        index = torch.tensor(rows)
        device = self.simulator.device
        return index.pin_memory().to(device, non_blocking=True) if device.type == "cuda" else index

    def _check(self, scene: Scene) -> None:
        shared = self.simulator.scene
        for name in ("plate_size_m", "height_samples", "image_pixels", "n_wavelengths"):
            mine, other = getattr(shared, name), getattr(scene, name)
            if mine != other:
                raise InputError(
                    f"a scene has {name} {other}, the others {mine}; benches of one batch share plate and grids, "
                    f"set scene.{name} to {mine}"
                )
