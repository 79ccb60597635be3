"""Where batches come from: fresh samples, a pool of them, or files.

A batch is a dictionary of float32 tensors on the device:

=========  ====================================================================
kind       entries
=========  ====================================================================
denoiser   noisy, clean: shape [B, n_w, m, m] [W/m^2]
updater    heights, start, gradient: [B, n, n]; target, simulated: [B, n_w, m, m]
direct     image: [B, n_w, m, m]; heights: [B, n, n] [m]
unrolled   image, heights, start
=========  ====================================================================
"""

from collections.abc import Callable
from typing import Any, Protocol

import torch

from data_gen.samples import Denoiser, DenoiserSampler, Reliefs, UpdaterSampler
from nets.training.config import LATTICE, RunConfig
from nets.training.imaging import Imager, VariedImager
from nets.training.keys import batch_ids, fresh_dataset, step_generator
from nets.training.own_starts import OwnStarts
from nets.training.precision import autocast
from nets.training.strokes import AHEAD, StrokeStream
from warp_caustics.errors import InputError, MismatchError

Batch = dict[str, torch.Tensor]

IMAGES = {
    "denoiser": ("noisy", "clean"),
    "updater": ("target", "simulated"),
    "direct": ("image",),
    "unrolled": ("image",),
}
"""Entries of a batch that are images."""
HEIGHT_MAPS = {"denoiser": 0, "updater": 3, "direct": 1, "unrolled": 2}
"""Entries of a batch that have the shape of the heights."""


class Source(Protocol):
    """Batches by their number; each is a function of the configuration, its number and the rank."""

    steps_per_epoch: int
    """Batches until the next validation."""

    def batch(self, step: int) -> Batch:
        """Batch number ``step``; asked for in rising order."""

    def resume(self, step: int) -> None:
        """Prepare for ``step`` being the next batch asked for."""

    def validation(self) -> list[Batch]:
        """The fixed batches that networks are judged by."""

    def close(self) -> None:
        """Release threads and processes."""


class FreshSource:
    """Samples simulated on the device when they are needed.

    Args:
        config: the run.
        device: where.
        rank: which of the processes.
        world: how many.
    """

    def __init__(self, config: RunConfig, device: torch.device, rank: int = 0, world: int = 1):
        training = config.training
        self.config, self.device, self.rank, self.world = config, device, rank, world
        self.size = training.replay.fresh_per_step if training.replay.size else training.batch_size
        self.steps_per_epoch = training.steps_per_epoch * training.accumulate
        self._denoiser, self._denoiser_hash = frozen_denoiser(config, device)
        dataset = fresh_dataset(config, is_validation=False, denoiser=self._denoiser_hash)
        self._sampler: Any = None
        self._imager: VariedImager | None = None
        if config.kind == "denoiser":
            self._sampler = DenoiserSampler(dataset, device)
        elif config.kind == "updater":
            self._sampler = UpdaterSampler(dataset, device, self._denoiser)
        else:
            self._imager = VariedImager(config.scene, training.photons, training.seed, device)
        self.starts = OwnStarts(config, self._sampler, rank) if config.kind == "updater" else None
        self.with_start = config.kind == "unrolled"
        self.strokes = StrokeStream(dataset, device, with_start=self.with_start)

    def ids(self, step: int) -> range:
        """Sample numbers of a batch."""
        return batch_ids(step, self.rank, self.world, self.size)

    def batch(self, step: int) -> Batch:
        ids = self.ids(step)
        if self.starts is not None:
            return self.starts.fresh(ids, is_flat=self.starts.draws(step)[1])
        heights, *start = self.strokes.reliefs(ids, [self.ids(step + k) for k in range(1, AHEAD + 1)])
        if self.config.kind == "denoiser":
            return {"noisy": self._sampler.noisy(heights, ids), "clean": self._sampler.clean(heights, ids)}
        assert self._imager is not None
        batch = {"image": self._imager(heights, step, self.rank), "heights": heights}
        return {**batch, "start": start[0]} if start else batch

    def resume(self, step: int) -> None:
        """Nothing to do: a batch depends on its number only."""

    def validation(self) -> list[Batch]:
        dataset = fresh_dataset(self.config, is_validation=True, denoiser=self._denoiser_hash)
        count, size = self.config.training.validation.count, self.config.training.batch_size
        parts = [range(first, min(first + size, count)) for first in range(0, count, size)]
        if self.config.kind == "updater":
            updater = UpdaterSampler(dataset, self.device, self._denoiser)
            return [updater.draw_tensors(ids)[0] for ids in parts]
        reliefs = Reliefs(dataset, self.device)
        if self.config.kind == "denoiser":
            pairs = DenoiserSampler(dataset, self.device)
            fields = [(ids, reliefs.true(ids)) for ids in parts]
            return [{"noisy": pairs.noisy(h, ids), "clean": pairs.clean(h, ids)} for ids, h in fields]
        imager, batches = Imager(self.config.scene, LATTICE, self.device), []
        for ids in parts:
            heights = reliefs.true(ids)
            batches.append({"image": imager(heights), "heights": heights})
            if self.with_start:
                batches[-1]["start"] = reliefs.perturbed(ids)[0]
        return batches

    def close(self) -> None:
        self.strokes.close()


class ReplaySource:
    """Batches drawn from a pool of the last fresh samples, which stays on the device.

    Round r brings fresh batch r; step k draws after round k + P - 1, where the
    first P rounds fill the pool before training. Images are kept as float16.
    On resume the pool is simulated again, sample by sample the same

    Args:
        fresh: makes the samples.
        batch_size: samples drawn per step.
    """

    def __init__(self, fresh: FreshSource, batch_size: int):
        replay = fresh.config.training.replay
        self.fresh, self.batch_size = fresh, batch_size
        self.slots = max(1, replay.size // fresh.size)
        """Fresh batches that the pool holds."""
        self.first_rounds = min(self.slots, -(-4 * batch_size // fresh.size))
        self.steps_per_epoch = fresh.steps_per_epoch
        self.pool: Batch = {}
        self.rounds = 0
        self.network: Callable[..., Any] | None = None
        """Continues samples where ``own_share`` asks for it; None leaves it out."""
        if self.slots * fresh.size < batch_size:
            raise InputError(
                f"training.replay.size {replay.size} is smaller than a batch of {batch_size}; raise it to "
                f"{100 * batch_size}, or 0 for no pool"
            )

    @property
    def bytes_needed(self) -> int:
        """Memory of the full pool."""
        scene, kind = self.fresh.config.scene, self.fresh.config.kind
        per_sample = 2 * scene.n_wavelengths * scene.image_pixels**2 * len(IMAGES[kind])
        per_sample += 4 * scene.height_samples**2 * HEIGHT_MAPS[kind]
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

    def validation(self) -> list[Batch]:
        return self.fresh.validation()

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
                    dtype = torch.float16 if name in IMAGES[self.fresh.config.kind] else torch.float32
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


def frozen_denoiser(config: RunConfig, device: torch.device) -> tuple[Denoiser | None, str | None]:
    """The network that denoises simulated images, and its content hash.

    Raises:
        MismatchError: the file holds another kind of network.
    """
    path = config.training.denoiser_weights
    if path is None:
        return None, None
    from nets.weights import load_weights

    loaded = load_weights(path, map_location=device)
    if loaded.info.architecture.kind != "denoiser":
        raise MismatchError(f"{path!r} holds a {loaded.info.architecture.kind} network; give a denoiser")
    network = loaded.module.requires_grad_(False)

    def denoised(images: torch.Tensor) -> torch.Tensor:
        with autocast(config.training.precision, device):
            answer: torch.Tensor = network(images)
        return answer

    return denoised, loaded.info.content_hash


def make_source(config: RunConfig, device: torch.device, rank: int = 0, world: int = 1) -> Source:
    """The source of a run's batches."""
    if config.training.fixed_samples:
        from nets.training.fixed import FixedSource

        own = config.model_copy(update={"training": config.training.model_copy(update={"fixed_samples": 0})})
        return FixedSource(make_source(own, device, rank, world), config, device, rank)
    if config.data is not None:
        from nets.training.files import FileSource

        return FileSource(config, device, rank, world)
    fresh = FreshSource(config, device, rank, world)
    return ReplaySource(fresh, config.training.batch_size) if config.training.replay.size else fresh
