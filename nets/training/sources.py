"""Where batches come from: fresh samples, files, or a pool that stays on the device.

A pool of the last fresh samples trains on each of them several times; one that
is filled once and never changes lets many short trainings share its samples.
"""

from collections.abc import Callable
from typing import Any

import torch

from nets.told import CAMERA, told_count
from nets.training.batch import HEIGHT_MAPS, IMAGES, Batch, Source, Told, silent
from nets.training.bench_source import BenchSource
from nets.training.config import RunConfig, network_feedback
from nets.training.files import FileSource
from nets.training.fresh import FreshSource
from nets.training.keys import step_generator
from warp_caustics.errors import InputError, ResourceError


def make_source(config: RunConfig, device: torch.device, rank: int = 0, world: int = 1) -> Source:
    """The source of a run's batches."""
    if config.training.fixed_samples:
        own = config.model_copy(update={"training": config.training.model_copy(update={"fixed_samples": 0})})
        return FixedSource(make_source(own, device, rank, world), config, device, rank)
    if config.data is not None:
        return FileSource(config, device, rank, world)
    of_benches = config.training.bench is not None
    fresh = BenchSource(config, device, rank, world) if of_benches else FreshSource(config, device, rank, world)
    return ReplaySource(fresh, config.training.batch_size) if config.training.replay.size else fresh


class ReplaySource:
    """Batches drawn from a pool of the last fresh samples, which stays on the device.

    Round r brings fresh batch r; step k draws after round k + P - 1, where the
    first P rounds fill the pool before training. Images are kept as float16.
    On resume the pool is simulated again, sample by sample the same; only answers of the network in it are then those
    of the network as it is now.

    Args:
        fresh: makes the samples.
        batch_size: samples drawn per step.
    """

    def __init__(self, fresh: FreshSource | BenchSource, batch_size: int):
        replay = fresh.config.training.replay
        self.fresh, self.batch_size = fresh, batch_size
        self.slots = max(1, replay.size // fresh.size)
        """Fresh batches that the pool holds."""
        self.first_rounds = min(self.slots, -(-4 * batch_size // fresh.size))
        self.steps_per_epoch = fresh.steps_per_epoch
        self.pool: Batch = {}
        self.rounds = 0
        self._network: Callable[..., Any] | None = None
        if self.slots * fresh.size < batch_size:
            raise InputError(
                f"training.replay.size {replay.size} is smaller than a batch of {batch_size}; raise it to "
                f"{100 * batch_size}, or 0 for no pool"
            )

    @property
    def network(self) -> Callable[..., Any] | None:
        """Continues samples where ``own_share`` asks for it, and answers where it has feedback; None leaves both."""
        return self._network

    @network.setter
    def network(self, network: Callable[..., Any] | None) -> None:
        self._network = network
        if isinstance(self.fresh, BenchSource):
            self.fresh.network = network

    @property
    def bytes_needed(self) -> int:
        """Memory of the full pool."""
        scene, kind = self.fresh.config.scene, self.fresh.config.kind
        has_feedback, told = network_feedback(self.fresh.config), told_count(scene.n_wavelengths) - len(CAMERA)
        per_sample = 2 * scene.n_wavelengths * scene.image_pixels**2 * (len(IMAGES[kind]) + has_feedback)
        per_sample += 4 * scene.height_samples**2 * (HEIGHT_MAPS[kind] + has_feedback)
        if self.fresh.config.training.bench is not None:
            per_sample += 4 * (told + has_feedback * (2 * told + 1))
        return self.slots * self.fresh.size * per_sample

    def batch(self, step: int) -> Batch:
        self._fill(step + self.first_rounds)
        available = min(self.rounds, self.slots) * self.fresh.size
        generator = step_generator(self._seed, "replay", step, self.fresh.rank, self.fresh.device)
        chosen = torch.randint(available, (self.batch_size,), generator=generator, device=self.fresh.device)
        return {name: kept[chosen].float() for name, kept in self.pool.items()}

    def resume(self, step: int) -> None:
        """Simulate the pool as it was before ``step``."""
        self.rounds = max(0, step + self.first_rounds - 1 - self.slots)
        self._fill(step + self.first_rounds - 1)

    def validation(self, told: Told = silent) -> list[Batch]:
        return self.fresh.validation(told)

    def close(self) -> None:
        self.fresh.close()

    @property
    def _seed(self) -> int:
        return self.fresh.config.training.seed

    @torch.no_grad()
    def _fill(self, rounds: int) -> None:
        while self.rounds < rounds:
            first = self.rounds % self.slots * self.fresh.size
            batch = self._continued(self.rounds) or self.fresh.batch(self.rounds)
            for name, values in batch.items():
                if name not in self.pool:
                    dtype = torch.float16 if name in (*IMAGES[self.fresh.config.kind], "echo") else torch.float32
                    shape = (self.slots * self.fresh.size, *values.shape[1:])
                    self.pool[name] = torch.empty(shape, dtype=dtype, device=values.device)
                # The brightest focal lines are cut, where float16 would be infinite.
                limit = torch.finfo(self.pool[name].dtype).max
                self.pool[name][first : first + self.fresh.size] = values.clamp(max=limit)
            self.rounds += 1

    def _continued(self, round_: int) -> Batch | None:
        """Samples of the pool one step further; None where new ones are due."""
        starts = self.fresh.starts
        if self.network is None or starts is None or not self.pool or not starts.draws(round_)[0]:
            return None
        available = min(round_, self.slots) * self.fresh.size
        generator = step_generator(self._seed, "continued", round_, self.fresh.rank, self.fresh.device)
        chosen = torch.randint(available, (self.fresh.size,), generator=generator, device=self.fresh.device)
        batch = {name: kept[chosen].float() for name, kept in self.pool.items()}
        answers = self.network(batch["target"], batch["simulated"], batch["start"], batch["gradient"])
        return starts.continued(batch, answers, self.fresh.ids(round_))


def check_pool(pool: ReplaySource) -> str:
    """What a pool takes, in a line.

    Raises:
        ResourceError: more than its GPU has free.
    """
    device, count, size = pool.fresh.device, pool.fresh.config.training.replay.size, pool.bytes_needed / 2**30
    if device.type == "cuda":
        free = torch.cuda.mem_get_info(device)[0] / 2**30
        if size > free:
            raise ResourceError(
                f"the pool of {count} samples needs {size:.1f} GiB, {device} has {free:.1f} GiB free; "
                "lower training.replay.size"
            )
    return f"pool       {count} samples, {size:.2f} GiB on {device}"


class FixedSource:
    """The first samples of another source, kept on the device; each step draws a batch of them.

    Where samples are slow to make, many short trainings can share them. A
    network can learn them by heart: the validation samples are others.

    Args:
        inner: makes the samples.
        config: the run; gives ``fixed_samples``, the steps of an epoch and the seed.
        device: where.
        rank: which of the processes.
    """

    def __init__(self, inner: Source, config: RunConfig, device: torch.device, rank: int = 0):
        self.inner, self.training, self.device, self.rank = inner, config.training, device, rank
        self.steps_per_epoch = config.training.steps_per_epoch * config.training.accumulate
        self.pool: Batch = {}

    def batch(self, step: int) -> Batch:
        self.fill()
        size, available = self.training.batch_size, self.training.fixed_samples
        generator = step_generator(self.training.seed, "fixed", step, self.rank, self.device)
        chosen = torch.randint(available, (size,), generator=generator, device=self.device)
        return {name: kept[chosen] for name, kept in self.pool.items()}

    def fill(self) -> None:
        """Make the samples, unless they are there."""
        if self.pool:
            return
        count = self.training.fixed_samples
        self.inner.resume(0)
        for number in range(-(-count // self.training.batch_size)):
            first = number * self.training.batch_size
            for name, values in self.inner.batch(number).items():
                if name not in self.pool:
                    self.pool[name] = values.detach().new_empty((count, *values.shape[1:]))
                self.pool[name][first : first + len(values)] = values[: count - first].detach()

    def resume(self, step: int) -> None:
        """Nothing to do: a batch depends on its number only."""

    def validation(self, told: Told = silent) -> list[Batch]:
        return self.inner.validation(told)

    def close(self) -> None:
        self.inner.close()
        self.pool = {}
