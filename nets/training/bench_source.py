"""Samples on benches of their own, simulated when they are needed.

An image is what dark and flat frames leave of a photo: the light on the screen relative to that behind a flat plate on
the same bench, times L_i. So the falloff of a lamp nearby is not in it, whether or not the network is told of the lamp;
a reconstruction divides by that of the scene it is told (:meth:`nets.flat_light.FlatLight.level`).
"""

from collections.abc import Callable
from typing import Any

import torch

from nets.flat_light import FlatLight
from nets.told import ToldTable
from nets.training.batch import Batch, Told, silent
from nets.training.bench_stream import BenchStream, OnBenches
from nets.training.config import LATTICE, RunConfig, network_feedback
from nets.training.feedback import Feedback, ToldAhead
from nets.training.imaging import BenchImager, Imager, VariedBenchImager
from nets.training.keys import batch_ids, fresh_dataset

AHEAD = 4
"""Batches drawn in advance."""


class BenchSource:
    """Fresh samples of a run with ``training.bench``; arguments as of :class:`nets.training.fresh.FreshSource`."""

    starts: Any = None
    """No sample continues another."""

    def __init__(self, config: RunConfig, device: torch.device, rank: int = 0, world: int = 1):
        training = config.training
        self.config, self.device, self.rank, self.world = config, device, rank, world
        self.size = training.replay.fresh_per_step if training.replay.size else training.batch_size
        self.steps_per_epoch = training.steps_per_epoch * training.accumulate
        self.flat = FlatLight(ToldTable(config.scene, device))
        self.imager = VariedBenchImager(config.scene, training.photons, training.seed, device)
        dataset, has_feedback = fresh_dataset(config, is_validation=False), network_feedback(config)
        self.feedback = Feedback(config, device, rank) if has_feedback else None
        self.stream = BenchStream(dataset, device, training.scene_share, ToldAhead(config) if has_feedback else None)
        self.network: Callable[..., Any] | None = None
        """Answers, where the run's network has feedback; None leaves its answers flat."""

    def ids(self, step: int) -> range:
        """Sample numbers of a batch."""
        return batch_ids(step, self.rank, self.world, self.size)

    def batch(self, step: int) -> Batch:
        plates = self.stream(self.ids(step), [self.ids(step + k) for k in range(1, AHEAD + 1)])
        batch = self._batch(plates, self.imager(plates.heights, plates.scenes, step, self.rank))
        if self.feedback is not None and plates.told is not None:
            batch |= self.feedback(batch, plates.told, step, self.network)
        return batch

    def _batch(self, plates: OnBenches, light: torch.Tensor) -> Batch:
        return {"image": light / self.flat.level(plates.values), "heights": plates.heights, "bench": plates.values}

    def resume(self, step: int) -> None:
        """Nothing to do: a batch depends on its number only."""

    def validation(self, told: Told = silent) -> list[Batch]:
        count, size = self.config.training.validation.count, self.config.training.batch_size
        imager = BenchImager(self.config.scene, LATTICE, self.device)
        default = Imager(self.config.scene, LATTICE, self.device)
        stream = BenchStream(fresh_dataset(self.config, is_validation=True), self.device)
        batches = []
        for first in range(0, count, size):
            told(first, count)
            plates = stream(range(first, min(first + size, count)))
            batch = self._batch(plates, imager(plates.heights, plates.scenes))
            batches.append({**batch, "default_image": default(plates.heights)})
        stream.close()
        told(count, count)
        return batches

    def close(self) -> None:
        """End the thread that draws."""
        self.stream.close()
