"""Batches from a pool of samples that is filled once and never changes."""

import torch

from nets.training.config import RunConfig
from nets.training.keys import step_generator
from nets.training.sources import Batch, Source


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

    def validation(self) -> list[Batch]:
        return self.inner.validation()

    def close(self) -> None:
        self.inner.close()
        self.pool = {}
