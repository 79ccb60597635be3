"""Samples simulated when they are needed: printed reliefs drawn ahead of time, images, starts of the updater.

The paper trains the updater on single steps from perturbed reliefs. What it meets
at its second step is a relief of its own making, of a kind that it never saw, and
errors grow from step to step. Here a share of the new samples start from the
network's own answer to a sample that was trained on before, and that answer to it
in turn: no step is repeated, so a sample costs what any fresh one costs.
"""

from collections.abc import Callable, Iterable
from typing import Any

import torch

from data_gen.dataset_config import DatasetConfig
from data_gen.patterns import padded
from data_gen.samples import DenoiserSampler, Reliefs, UpdaterSampler
from nets.training.batch import Batch, Told, silent
from nets.training.config import LATTICE, RunConfig
from nets.training.drawn_ahead import DrawnAhead, sendable
from nets.training.imaging import Imager, VariedImager
from nets.training.keys import batch_ids, fresh_dataset, step_generator
from nets.training.weights import frozen_denoiser
from warp_caustics.data_gradient import possible_heights

AHEAD = 4
"""Batches drawn in advance."""


class StrokeStream:
    """Reliefs of consecutive batches of samples.

    Strokes are drawn on the CPU (tens of microseconds each) while the device
    works on the batches before, and printed on the device.

    Args:
        dataset: gives pattern, scene and keys.
        device: where heights are wanted.
        with_start: also print the perturbed strokes.
    """

    def __init__(self, dataset: DatasetConfig, device: torch.device, *, with_start: bool):
        self.source, self.device, self.with_start = Reliefs(dataset, device), device, with_start
        self._ahead = DrawnAhead(self._drawn)

    def reliefs(self, ids: range, following: Iterable[range] = ()) -> list[torch.Tensor]:
        """Heights [m], shape [len(ids), n, n], of the true relief and, where wanted, of the perturbed one.

        Args:
            ids: sample numbers.
            following: batches that will be asked for next.
        """
        traits, *sets = self._ahead(ids, following)
        return [self.source.printed(strokes, traits) for strokes in sets]

    def close(self) -> None:
        """End the thread."""
        self._ahead.close()

    def _drawn(self, ids: range) -> list[torch.Tensor]:
        """Traits, strokes and, where wanted, perturbed strokes."""
        sets = [self.source.drawn(ids)]
        if self.with_start:
            pairs = zip(sets[0], ids, strict=True)
            sets.append([self.source.perturbed_strokes(strokes, sample)[0] for strokes, sample in pairs])
        tensors = [self.source.traits(ids), *(torch.from_numpy(padded(strokes)) for strokes in sets)]
        return [sendable(tensor, self.device) for tensor in tensors]


class OwnStarts:
    """Which fresh samples start where, and those that continue others.

    Args:
        config: the run; its shares.
        sampler: simulates.
        rank: which of the processes.
    """

    def __init__(self, config: RunConfig, sampler: UpdaterSampler, rank: int = 0):
        self.config, self.sampler, self.rank = config, sampler, rank

    def draws(self, round_: int) -> tuple[bool, bool]:
        """Whether a round continues samples of the pool; whether it starts flat if it does not."""
        generator = step_generator(self.config.training.seed, "own starts", round_, self.rank, torch.device("cpu"))
        own, flat = torch.rand(2, generator=generator).tolist()
        replay = self.config.training.replay
        return own < replay.own_share, flat < replay.flat_share

    def fresh(self, ids: range, is_flat: bool) -> Batch:
        """New samples, from perturbed reliefs or from a flat plate."""
        if not is_flat:
            return self.sampler.draw_tensors(ids)[0]
        heights = self.sampler.reliefs.true(ids)
        return self.sampler.at(heights, torch.zeros_like(heights), self.sampler.target(heights, ids), ids)

    def continued(self, batch: Batch, answers: torch.Tensor, ids: range) -> Batch:
        """The same samples one step further.

        Args:
            batch: samples.
            answers: of the network to them [m], shape [B, n, n].
            ids: of the new samples, for their photons.
        """
        start = possible_heights(answers, self.config.scene)
        return self.sampler.at(batch["heights"], start, batch["target"], ids)


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
            # Steps are simulated as a whole, and again as a whole on resuming.
            is_thinned = training.noisy.traced is not None
            self._sampler = UpdaterSampler(dataset, device, self._denoiser, shares_photons=is_thinned)
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

    def validation(self, told: Told = silent) -> list[Batch]:
        dataset = fresh_dataset(self.config, is_validation=True, denoiser=self._denoiser_hash)
        count, size = self.config.training.validation.count, self.config.training.batch_size
        parts = [range(first, min(first + size, count)) for first in range(0, count, size)]
        made, batches = self._maker(dataset), []
        for ids in parts:
            told(ids.start, count)
            batches.append(made(ids))
        told(count, count)
        return batches

    def _maker(self, dataset: DatasetConfig) -> Callable[[range], Batch]:
        """What makes validation samples of these numbers."""
        if self.config.kind == "updater":
            updater = UpdaterSampler(dataset, self.device, self._denoiser)
            return lambda ids: updater.draw_tensors(ids)[0]
        reliefs = Reliefs(dataset, self.device)
        if self.config.kind == "denoiser":
            pairs = DenoiserSampler(dataset, self.device)

            def pair(ids: range) -> Batch:
                heights = reliefs.true(ids)
                return {"noisy": pairs.noisy(heights, ids), "clean": pairs.clean(heights, ids)}

            return pair
        imager = Imager(self.config.scene, LATTICE, self.device)

        def image(ids: range) -> Batch:
            heights = reliefs.true(ids)
            start = {"start": reliefs.perturbed(ids)[0]} if self.with_start else {}
            return {"image": imager(heights), "heights": heights, **start}

        return image

    def close(self) -> None:
        self.strokes.close()
