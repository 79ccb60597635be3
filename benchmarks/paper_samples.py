"""Samples of the paper's trainings (`paper_recipe.py`), of which all networks of a process learn."""

from collections.abc import Sequence
from typing import NamedTuple

import torch

from data_gen.samples import UpdaterSampler
from nets.training.batch import Batch
from nets.training.config import RunConfig
from nets.training.fresh import StrokeStream
from nets.training.keys import fresh_dataset, step_generator
from nets.training.weights import frozen_denoiser

BATCH = 16
KEPT = ("target", "noisy", "denoised")
"""Images, kept in 16 bits."""


class Options(NamedTuple):
    """Of a training of all networks."""

    device: str
    epoch: int
    """Samples."""
    fresh: int
    """New samples in each step."""
    pool: int
    validation: int
    compile: bool
    traced: int
    """Photons of a simulated image."""


class Samples:
    """What all networks learn from: each sample with its image raw and denoised, and the gradient of either.

    Args:
        config: gives data set and denoiser.
        device: where.
    """

    def __init__(self, config: RunConfig, device: torch.device, *, is_validation: bool = False):
        self.denoiser = frozen_denoiser(config, device)[0]
        dataset = fresh_dataset(config, is_validation=is_validation, denoiser=None)
        shares = config.training.noisy.traced is not None
        self.sampler = UpdaterSampler(dataset, device, shares_photons=shares)
        self.strokes = StrokeStream(dataset, device, with_start=True)

    def __call__(self, ids: range, following: Sequence[range] = ()) -> Batch:
        heights, start = self.strokes.reliefs(ids, following)
        target = self.sampler.target(heights, ids)
        (noisy, raw), (denoised, gradient) = self.sampler.simulated.with_gradients(
            start, target, ids, (None, self.denoiser)
        )
        return {
            "heights": heights,
            "start": start,
            "target": target,
            "noisy": noisy,
            "denoised": denoised,
            "gradient": gradient,
            "raw_gradient": raw,
        }


class Pool:
    """The last samples, of which each network draws its own batches.

    Args:
        samples: makes them.
        options: how many are kept, made in a step and different at all.
        device: where.
    """

    def __init__(self, samples: Samples, options: Options, device: torch.device):
        self.samples, self.options, self.device = samples, options, device
        self.slots = max(1, options.pool // options.fresh)
        self.rounds, self.kept = 0, Batch()

    def ids(self, round_: int) -> range:
        """Sample numbers of a round; after an epoch's samples the first come again."""
        first = round_ * self.options.fresh % (self.options.epoch // self.options.fresh * self.options.fresh)
        return range(first, first + self.options.fresh)

    @torch.no_grad()
    def fill(self, rounds: int) -> None:
        """Have the samples of so many rounds; those that would be replaced again are not made."""
        self.rounds = max(self.rounds, rounds - self.slots)
        while self.rounds < rounds:
            batch = self.samples(self.ids(self.rounds), [self.ids(self.rounds + k) for k in range(1, 5)])
            first = self.rounds % self.slots * self.options.fresh
            for name, values in batch.items():
                if name not in self.kept:
                    dtype = torch.float16 if name in KEPT else torch.float32
                    shape = (self.slots * self.options.fresh, *values.shape[1:])
                    self.kept[name] = torch.empty(shape, dtype=dtype, device=self.device)
                limit = torch.finfo(self.kept[name].dtype).max
                self.kept[name][first : first + self.options.fresh] = values.clamp(max=limit)
            self.rounds += 1

    def batch(self, step: int, seed: int) -> Batch:
        """A network's batch of a step."""
        available = min(self.rounds, self.slots) * self.options.fresh
        generator = step_generator(seed, "pool", step, 0, self.device)
        chosen = torch.randint(available, (BATCH,), generator=generator, device=self.device)
        return {name: kept[chosen].float() for name, kept in self.kept.items()}
