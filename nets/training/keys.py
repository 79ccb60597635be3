"""Which samples a step takes, and random numbers that depend on seed and step alone.

Nothing here has a state: a resumed run needs only the number of the next step.
"""

import hashlib

import torch

from data_gen.dataset_config import MAX_SAMPLES, DatasetConfig
from nets.training.config import RunConfig


def batch_ids(step: int, rank: int, world: int, batch: int) -> range:
    """Numbers of the fresh samples of one step; ranks and steps share none.

    Args:
        step: number of the batch, from 0.
        rank: which of the processes.
        world: how many processes.
        batch: samples per process.
    """
    first = (step * world + rank) * batch
    return range(first, first + batch)


def step_seed(seed: int, purpose: str, step: int, rank: int = 0) -> int:
    """Seed below 2^63 for one purpose of one step; a hash, so that nothing repeats in neighbours."""
    digest = hashlib.sha256(f"{seed}/{purpose}/{rank}/{step}".encode()).digest()
    return int.from_bytes(digest[:8], "little") >> 1


def step_generator(seed: int, purpose: str, step: int, rank: int, device: torch.device) -> torch.Generator:
    """Random numbers on a device for one purpose of one step."""
    return torch.Generator(device).manual_seed(step_seed(seed, purpose, step, rank))


def fresh_dataset(config: RunConfig, *, is_validation: bool, denoiser: str | None = None) -> DatasetConfig:
    """The endless data set that fresh samples are numbered in; ``denoiser`` is its network's content hash.

    Training and validation differ in their seed, both from role ``"test"`` in
    their role: no sample of one is in another.
    """
    training = config.training
    return DatasetConfig.model_validate(
        {
            "kind": "denoiser" if config.kind == "denoiser" else "updater" if training.bench is None else "capture",
            "n_samples": MAX_SAMPLES,
            "seed": training.validation.seed if is_validation else training.seed,
            "role": "data",
            "scene": config.scene,
            "reliefs": config.reliefs,
            "noisy": training.noisy,
            "clean": training.clean,
            "denoiser": denoiser,
            "bench": training.bench,
        }
    )
