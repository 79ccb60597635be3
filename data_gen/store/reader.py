"""A data set for training: every array checked against its hash before anybody sees it."""

import hashlib
import os
from collections.abc import Callable, Iterable
from typing import Any, Literal

import numpy as np
import torch
from torch.utils.data import Dataset

from data_gen.store.files import MOST_OPEN, ShardFiles
from data_gen.store.folder import load_complete, open_folder
from data_gen.store.manifest import Complete
from data_gen.store.shard import sample_digest
from data_gen.store.verification import check_shard
from warp_caustics.errors import DamagedDataError, InputError, MismatchError
from warp_caustics.io.atomic import PathLike, reason

Split = Literal["train", "val"]
Sample = dict[str, Any]

VAL_FRACTION = 0.1


class CausticDataset(Dataset[Sample]):
    """Samples of a built data set, by position.

    A sample is a dictionary of tensors, one per field, and its number as ``"id"``. Files are opened when they are
    needed, in the process that needs them; the virtual index is never used, because it returns NaN for files it
    cannot open.

    Args:
        directory: the data set's folder.
        fields: names of the arrays to read; all if None.
        split: ``"train"`` or ``"val"``, decided by a hash of the sample's number alone and so the same for ever;
            None takes both.
        ids: only these samples; of the split, if one is given.
        val_fraction: share of the validation samples.
        partial: accept an unfinished data set and take the shards that are there.
        transform: applied to each sample.
        most_open: files open at a time.
        check: compare each array with its hash when it is first read in a process.

    Raises:
        MismatchError: the data set is unfinished.
        DamagedDataError: files are missing or broken.
        InputError: it is no data set, or does not have such fields or samples.
    """

    def __init__(
        self,
        directory: PathLike,
        fields: Iterable[str] | None = None,
        *,
        split: Split | None = None,
        ids: Iterable[int] | None = None,
        val_fraction: float = VAL_FRACTION,
        partial: bool = False,
        transform: Callable[[Sample], Sample] | None = None,
        most_open: int = MOST_OPEN,
        check: bool = True,
    ) -> None:
        self.layout, self.config = open_folder(directory)
        self.transform, self._most_open, self._check = transform, most_open, check
        complete = load_complete(self.layout, self.config.fingerprint)
        self._entries = {entry.shard: entry for entry in complete.entries} if complete else {}
        shards = self._complete_shards(complete) if complete else self._published_shards(partial)
        self.ids = _selected(self._available(shards), split, ids, val_fraction)
        self._process, self._files = -1, self._closed_files()
        self.fields = self._known_fields(shards, fields)
        self._checked = np.zeros(self.config.n_samples, bool)

    def __len__(self) -> int:
        return len(self.ids)

    def __getitem__(self, index: int) -> Sample:
        """A sample by position.

        Raises:
            DamagedDataError: its file is missing or broken; names file and sample.
        """
        sample = int(self.ids[index])
        arrays = self._read(sample)
        item: Sample = {name: torch.from_numpy(array) for name, array in arrays.items()}
        item["id"] = sample
        return self.transform(item) if self.transform else item

    def __getstate__(self) -> dict[str, Any]:
        # What a process has open and has checked is its own.
        checked = np.zeros_like(self._checked)
        return {**self.__dict__, "_files": self._closed_files(), "_process": -1, "_checked": checked}

    def close(self) -> None:
        """Close all files; they are opened again when needed."""
        self._files.close()

    def _read(self, sample: int) -> dict[str, np.ndarray[Any, Any]]:
        shard, row = divmod(sample, self.config.samples_per_shard)
        if self._process != os.getpid():
            # After a fork the parent's handles are here too, and not to be shared.
            self._process, self._files = os.getpid(), self._closed_files()
        try:
            opened = self._files[shard]
            arrays = {name: np.asarray(opened.datasets[name][row]) for name in self.fields}
        except MemoryError:
            raise
        except DamagedDataError as error:
            raise self._damaged(sample, shard, str(error)) from error
        except Exception as error:
            # A damaged file makes HDF5 raise whatever comes to its mind.
            raise self._damaged(sample, shard, f"cannot be read ({reason(error)})") from error
        if self._check and not self._checked[sample]:
            for name, array in arrays.items():
                if sample_digest(sample, name, array) != opened.manifest.samples[name][row]:
                    raise self._damaged(sample, shard, f"{name} does not match its hash")
            self._checked[sample] = True
        return arrays

    def _damaged(self, sample: int, shard: int, what: str) -> DamagedDataError:
        return DamagedDataError(
            f"{str(self.layout.shard(shard))!r}, sample {sample}: {what}; build again with a full check to repair"
        )

    def _closed_files(self) -> ShardFiles:
        return ShardFiles(self.layout, self.config, self._entries, self._most_open)

    def _complete_shards(self, complete: Complete) -> list[int]:
        names = {entry.name for entry in os.scandir(self.layout.shards)} if self.layout.shards.is_dir() else set()
        for shard in range(self.config.n_shards):
            if shard not in self._entries or self.layout.shard(shard).name not in names:
                raise DamagedDataError(f"{str(self.layout.shard(shard))!r} is missing; build again to repair")
        if complete.n_samples != self.config.n_samples:
            raise DamagedDataError(f"COMPLETE.json lists {complete.n_samples} of {self.config.n_samples} samples")
        return list(range(self.config.n_shards))

    def _published_shards(self, partial: bool) -> list[int]:
        count = self.config.n_shards
        shards = [shard for shard in range(count) if check_shard(self.layout, self.config, shard)[1] is None]
        if not partial:
            raise MismatchError(
                f"{str(self.layout.root)!r} is unfinished: {len(shards)}/{count} shards; "
                "finish building it, or use partial=True"
            )
        return shards

    def _available(self, shards: list[int]) -> np.ndarray[Any, np.dtype[np.int64]]:
        parts = [np.asarray(self.config.shard_ids(shard), np.int64) for shard in shards]
        return np.concatenate(parts) if parts else np.zeros(0, np.int64)

    def _known_fields(self, shards: list[int], wanted: Iterable[str] | None) -> tuple[str, ...]:
        if not shards:
            return tuple(wanted or ())
        # One manifest is enough: a builder refuses to mix.
        manifest, problem = check_shard(self.layout, self.config, shards[0], entry=self._entries.get(shards[0]))
        if manifest is None or problem is not None:
            raise DamagedDataError(f"{problem or shards[0]}; build again to repair")
        known = tuple(field.name for field in manifest.fields)
        names = known if wanted is None else tuple(wanted)
        unknown = [name for name in names if name not in known]
        if unknown or not names:
            raise InputError(f"fields {unknown} are not in {str(self.layout.root)!r}; use some of {', '.join(known)}")
        return names


def is_validation(sample: int, fraction: float = VAL_FRACTION) -> bool:
    """Does a sample belong to the validation part? Decided by its number alone, whatever the size of the data set.

    A sample has one base relief, so no relief is in both parts. A larger fraction only adds samples.
    """
    digest = hashlib.sha256(f"validation/{sample}".encode()).digest()
    return int.from_bytes(digest[:8], "little") < fraction * 2**64


def _selected(
    available: np.ndarray[Any, np.dtype[np.int64]], split: Split | None, ids: Iterable[int] | None, fraction: float
) -> np.ndarray[Any, np.dtype[np.int64]]:
    if split not in ("train", "val", None):
        raise InputError(f"split {split!r} is not known; use 'train', 'val' or None")
    if not 0 <= fraction < 1:
        raise InputError(f"val_fraction {fraction!r} must be at least 0 and below 1")
    if ids is not None:
        wanted = np.asarray(list(ids), np.int64)
        absent = np.setdiff1d(wanted, available)
        if absent.size:
            raise InputError(f"samples {absent[:4].tolist()}... are not in the data set; it has {available.size}")
        available = wanted
    if split is None:
        return available
    keep = [is_validation(int(sample), fraction) == (split == "val") for sample in available]
    selected: np.ndarray[Any, np.dtype[np.int64]] = available[np.asarray(keep, bool)]
    return selected
