"""Batches from a data set on disk."""

import itertools
import os
from collections.abc import Iterator
from typing import Any

import numpy as np
import torch
from torch.utils.data import DataLoader, Sampler

from data_gen.dataset_config import DatasetConfig
from data_gen.store import CausticDataset
from nets.training.batch import Batch, Told, silent
from nets.training.config import RunConfig
from nets.training.keys import step_seed
from warp_caustics.errors import CausticsError, InputError, MismatchError, ResourceError

FIELDS = {
    "denoiser": {"noisy": "noisy", "clean": "clean"},
    "updater": {name: name for name in ("heights", "start", "target", "simulated", "gradient")},
    "direct": {"target": "image", "heights": "heights"},
    "unrolled": {"target": "image", "heights": "heights", "start": "start"},
}
"""Arrays of a data set that a kind of training reads, and their names in a batch."""


class StepSampler(Sampler[list[int]]):
    """Positions of the samples of step ``first``, ``first`` + 1, ...: endless, a new order in every epoch.

    What is left at the end of an epoch and fills no batch is left out of it.

    Args:
        count: samples in the data set.
        batch: samples per process and step.
        seed: of the order.
        rank: which of the processes.
        world: how many.
    """

    def __init__(self, count: int, batch: int, seed: int, rank: int = 0, world: int = 1):
        self.count, self.batch, self.seed, self.rank, self.world = count, batch, seed, rank, world
        self.steps_per_epoch = count // (batch * world)
        self.first = 0

    def __iter__(self) -> Iterator[list[int]]:
        order, of_epoch = np.zeros(0, np.int64), -1
        for step in itertools.count(self.first):
            epoch, within = divmod(step, self.steps_per_epoch)
            if epoch != of_epoch:
                key = step_seed(self.seed, "order", epoch)
                order, of_epoch = np.random.Generator(np.random.Philox(key)).permutation(self.count), epoch
            first = (within * self.world + self.rank) * self.batch
            yield order[first : first + self.batch].tolist()


class FileSource:
    """Samples of a built data set, its fixed 90 % for training and 10 % for validation.

    Args:
        config: the run.
        device: where batches are wanted.
        rank: which of the processes.
        world: how many.

    Raises:
        MismatchError: a data set of another kind or scene.
        InputError: fewer samples than a batch.
    """

    def __init__(self, config: RunConfig, device: torch.device, rank: int = 0, world: int = 1):
        self.config, self.device, training = config, device, config.training
        self.names, folder = FIELDS[config.kind], config.data or ""
        _check(described(CausticDataset(folder)), config)
        self.training_set = CausticDataset(folder, list(self.names), split="train")
        self.validation_set = CausticDataset(folder, list(self.names), split="val")
        self.sampler = StepSampler(len(self.training_set), training.batch_size, training.seed, rank, world)
        self.steps_per_epoch = self.sampler.steps_per_epoch
        if self.steps_per_epoch == 0 or len(self.validation_set) == 0:
            raise InputError(
                f"data set {config.data!r} has {len(self.training_set)} samples for training and "
                f"{len(self.validation_set)} for validation; build more than {11 * training.batch_size * world}"
            )
        self.workers = reading_processes(training.data_workers, world)
        self.loader: DataLoader[Any] | None = None
        self.batches: Iterator[Any] = iter(())

    def batch(self, step: int) -> Batch:
        if self.loader is None:
            self.resume(step)
        try:
            sample = next(self.batches)
        except CausticsError as error:
            raise type(error)(_of_worker(str(error))) from error
        except RuntimeError as error:
            # torch has no type of its own for a process of the loader that was killed.
            if "DataLoader worker" not in str(error):
                raise
            raise ResourceError(
                f"a process that reads data set {self.config.data!r} was killed, mostly for want of memory; fewer such "
                "processes: --set training.data_workers=0"
            ) from error
        return self._moved(sample)

    def resume(self, step: int) -> None:
        self.close()
        workers = self.workers
        self.sampler.first = step
        self.loader = DataLoader(
            self.training_set,
            batch_sampler=self.sampler,
            num_workers=workers,
            # HDF5 and CUDA do not survive a fork.
            multiprocessing_context="spawn" if workers else None,
            prefetch_factor=4 if workers else None,
            pin_memory=self.device.type == "cuda",
        )
        self.batches = iter(self.loader)

    def validation(self, told: Told = silent) -> list[Batch]:
        """The first ``validation.count`` samples of the validation part; they stay on the device."""
        size, count = self.config.training.batch_size, self.config.training.validation.count
        positions = range(min(count, len(self.validation_set)))
        parts = [positions[first : first + size] for first in range(0, len(positions), size)]
        collate = torch.utils.data.default_collate
        batches = []
        for part in parts:
            told(part.start, len(positions))
            batches.append(self._moved(collate([self.validation_set[k] for k in part])))
        told(len(positions), len(positions))
        return batches

    def close(self) -> None:
        # Dropping the iterator ends its processes.
        self.batches, self.loader = iter(()), None

    def _moved(self, sample: dict[str, torch.Tensor]) -> Batch:
        on_device = {name: sample[name].to(self.device, non_blocking=True) for name in self.names}
        return {ours: on_device[name].float() for name, ours in self.names.items()}


def _of_worker(message: str) -> str:
    """The message of an error of ours that a process of the loader told with its whole traceback."""
    last = message.rstrip().rpartition("\n")[2]
    return last.partition(": ")[2] if message.startswith("Caught ") and ": " in last else message


def reading_processes(wanted: int | None, world: int) -> int:
    """How many processes read files for each of ``world`` trainings on this machine; half of the cores if None."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 2
    return wanted if wanted is not None else min(8, max(2, cores // (2 * world)))


def _check(found: DatasetConfig, config: RunConfig) -> None:
    """Refuse a data set that does not belong to the run."""
    wanted = "denoiser" if config.kind == "denoiser" else "updater"
    if found.kind != wanted:
        raise MismatchError(
            f"data set {config.data!r} is for the {found.kind}, {config.kind} training needs one for the {wanted}; "
            "build one"
        )
    if found.role != "data":
        raise MismatchError(f"data set {config.data!r} has role {found.role!r}, not 'data'; build one")
    if found.scene != config.scene:
        raise MismatchError(f"data set {config.data!r} is of another scene than the run; leave scene settings out")


def described(dataset: CausticDataset) -> DatasetConfig:
    """The configuration that a data set was built from."""
    tree = {key: value for key, value in dataset.config.tree.items() if key != "generator_version"}
    return DatasetConfig.model_validate(tree)


def data_fingerprint(path: str) -> str:
    """Fingerprint of a data set."""
    return CausticDataset(path).config.fingerprint
