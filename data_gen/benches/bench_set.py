"""The benches of a data set: drawn by sample number, and the images that plates show on them."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import torch

from data_gen.bench_ranges import BenchRanges
from data_gen.benches.columns import BenchBatch, bench_columns
from data_gen.benches.draw import draw_benches, scenes_of
from data_gen.benches.photos import Cameras, has_even_flat
from data_gen.benches.prints import PrintKinds
from data_gen.dataset_config import DatasetConfig
from data_gen.sampler import Column
from warp_caustics.errors import InputError
from warp_caustics.many_scenes import ManyScenes
from warp_caustics.scene import Scene

PHOTOS_AT_ONCE = {"cpu": 1, "cuda": 32}
"""Sums of matrix products may depend on how many there are; on a CPU, where a sample is the same to the bit, one."""


class Benches:
    """Benches of one data set, or of one training, by number.

    A bench depends on the configuration and its number, on nothing else; a photo on its bench and its plate.

    Args:
        config: gives the ranges, the scene and ``clean``, how light is simulated.
        fingerprint: selects the benches; the configuration's own if None.
        device: where to simulate.
    """

    def __init__(self, config: DatasetConfig, fingerprint: str | None = None, device: str | torch.device = "cpu"):
        self.config, self.fingerprint = config, fingerprint or config.sample_fingerprint()
        self.ranges = config.bench or BenchRanges()
        self.kinds = PrintKinds(config, self.fingerprint)
        self.screens = ManyScenes(config.scene, device=device, **config.clean.record())
        self.device = self.screens.simulator.device
        self.cameras = Cameras(self.ranges.camera, config.scene, self.device)

    @property
    def columns(self) -> tuple[Column, ...]:
        """What a bench is recorded as."""
        return bench_columns(self.config.scene.n_wavelengths)

    def draw(self, samples: Sequence[int]) -> BenchBatch:
        """Benches of samples."""
        return draw_benches(self.config, self.fingerprint, samples, self.kinds.columns(samples))

    def from_records(self, values: npt.NDArray[np.float64] | torch.Tensor) -> BenchBatch:
        """Benches of their records, shape [B, K], as a data set gives them.

        Raises:
            InputError: records of another number of columns.
        """
        array = np.asarray(values, dtype=np.float64)
        if array.ndim != 2 or array.shape[1] != len(self.columns):
            raise InputError(
                f"records have shape {list(array.shape)}; give [B, {len(self.columns)}], the field bench of a data set "
                f"of {self.config.scene.n_wavelengths} wavelengths"
            )
        return BenchBatch(self.config.scene.n_wavelengths, array)

    def scenes(self, benches: BenchBatch) -> list[Scene]:
        """Scenes of benches."""
        return scenes_of(self.config.scene, benches)

    def light(self, heights: torch.Tensor, benches: BenchBatch) -> torch.Tensor:
        """Irradiance on the benches' screens [W/m^2], shape [B, n_w, m, m], of heights [B, n, n] [m]: no camera yet."""
        return self.screens(heights, self.scenes(benches), self._seeds(benches))

    def images(self, heights: torch.Tensor, benches: BenchBatch) -> torch.Tensor:
        """Photos of plates as irradiance [W/m^2], shape [B, n_w, m, m].

        Args:
            heights: [m], shape [B, n, n], float32, on the device.
            benches: B of them.
        """
        step = PHOTOS_AT_ONCE[self.device.type]
        parts = [slice(first, first + step) for first in range(0, len(benches), step)]
        return torch.cat([self._photos(heights[part], benches[part]) for part in parts])

    @torch.no_grad()
    def _photos(self, heights: torch.Tensor, benches: BenchBatch) -> torch.Tensor:
        scenes, seeds = self.scenes(benches), self._seeds(benches)
        light = self.screens(heights, scenes, seeds)
        return self.cameras.photos(light, self._flats(scenes, benches), benches)

    def _flats(self, scenes: list[Scene], benches: BenchBatch) -> torch.Tensor | None:
        """Light behind plates without relief where frames are taken; None where all of it is even."""
        wanted = [
            row
            for row, (scene, frames) in enumerate(zip(scenes, benches.of("is_calibrated"), strict=True))
            if frames > 0 and not has_even_flat(scene)
        ]
        if not wanted:
            return None
        scene = self.config.scene
        m, n = scene.image_pixels, scene.height_samples
        flats = self.cameras.flat[:, None, None].repeat(len(scenes), 1, m, m).view(len(scenes), -1, m, m)
        level = torch.zeros(len(wanted), n, n, device=self.device)
        seeds = self._seeds(benches[np.array(wanted)], 1)
        flats[torch.tensor(wanted, device=self.device)] = self.screens(level, [scenes[row] for row in wanted], seeds)
        return flats

    def _seeds(self, benches: BenchBatch, purpose: int = 0) -> list[int]:
        """Of photons, where they are no lattice; the flat frame has its own."""
        return [2 * int(seed) + purpose for seed in benches.of("noise_seed")]
