"""A data set for training: every array checked against its hash before anybody sees it.

Few files are open at a time, and nothing in them points elsewhere.
"""

import errno
import hashlib
import os
import resource
from collections import OrderedDict
from collections.abc import Callable, Iterable
from typing import Any, Literal

import h5py
import numpy as np
import torch
from torch.utils.data import Dataset

from data_gen.sampler import Column, Field
from data_gen.store.folder import StoredConfig, load_complete, open_folder, present_shards
from data_gen.store.layout import Complete, Entry, Layout, read_manifest, sha256
from data_gen.store.shard import sample_digest
from data_gen.store.verification import check_shard
from warp_caustics.errors import DamagedDataError, InputError, MismatchError
from warp_caustics.io.atomic import PathLike, reason
from warp_caustics.io.regular import require_regular

Split = Literal["train", "val"]
Sample = dict[str, Any]

VAL_FRACTION = 0.1

MOST_OPEN = 64
_FILTERS = {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE}
_SHARE_OF_LIMIT = 4
"""Of the descriptors a process may have, one in so many: several data sets, pipes and libraries want some too."""


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
        complete = load_complete(self.layout, self.config)
        self._entries = {entry.shard: entry for entry in complete.entries} if complete else {}
        shards = self._complete_shards(complete) if complete else self._published_shards(partial)
        self.ids = _selected(self._available(shards), split, ids, val_fraction)
        self._process, self._files = -1, self._closed_files()
        self._described = self._described_fields(shards)
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

    def columns(self, name: str) -> tuple[Column, ...]:
        """Names, units and meanings of the numbers of a field such as ``bench``, in their order; none of an array."""
        return next((field.columns for field in self._described if field.name == name), ())

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

    def _closed_files(self) -> "ShardFiles":
        return ShardFiles(self.layout, self.config, self._entries, self._most_open)

    def _complete_shards(self, complete: Complete) -> list[int]:
        names = {entry.name for entry in os.scandir(self.layout.shards)} if self.layout.shards.is_dir() else set()
        for shard in range(self.config.n_shards):
            if shard not in self._entries or self.layout.shard(shard).name not in names:
                raise DamagedDataError(f"{str(self.layout.shard(shard))!r} is missing; build again to repair")
        return list(range(self.config.n_shards))

    def _published_shards(self, partial: bool) -> list[int]:
        count = self.config.n_shards
        present = present_shards(self.layout, self.config)
        shards = [shard for shard in present if check_shard(self.layout, self.config, shard)[1] is None]
        if not partial:
            raise MismatchError(
                f"{str(self.layout.root)!r} is unfinished: {len(shards)}/{count} shards; "
                "finish building it, or use partial=True"
            )
        return shards

    def _available(self, shards: list[int]) -> np.ndarray[Any, np.dtype[np.int64]]:
        parts = [np.asarray(self.config.shard_ids(shard), np.int64) for shard in shards]
        return np.concatenate(parts) if parts else np.zeros(0, np.int64)

    def _described_fields(self, shards: list[int]) -> tuple[Field, ...]:
        if not shards:
            return ()
        # One manifest is enough: a builder refuses to mix.
        manifest, problem = check_shard(self.layout, self.config, shards[0], entry=self._entries.get(shards[0]))
        if manifest is None or problem is not None:
            raise DamagedDataError(f"{problem or shards[0]}; build again to repair")
        return manifest.fields

    def _known_fields(self, shards: list[int], wanted: Iterable[str] | None) -> tuple[str, ...]:
        if not shards:
            return tuple(wanted or ())
        known = tuple(field.name for field in self._described)
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


class OpenShard:
    """A shard that is open.

    Attributes:
        manifest: of the shard.
        datasets: field name to HDF5 data set.

    Raises:
        DamagedDataError: the file is not what its manifest says; the path is left to the caller to name.
    """

    def __init__(self, layout: Layout, config: StoredConfig, shard: int, entry: Entry | None) -> None:
        path = layout.shard(shard)
        manifest = read_manifest(layout.manifest(shard))
        if manifest is None:
            raise DamagedDataError("it has no manifest")
        if entry is not None and sha256(manifest.to_bytes()) != entry.manifest_sha256:
            raise DamagedDataError("the manifest is not the one that COMPLETE.json lists")
        if manifest.fingerprint != config.fingerprint or manifest.shard != shard:
            raise DamagedDataError("the manifest is another shard's or another data set's")
        if manifest.ids != tuple(config.shard_ids(shard)):
            raise DamagedDataError("the manifest lists other samples")
        self.manifest = manifest
        size = require_regular(path).st_size
        # Published files never change, and locks fail on many network file systems.
        self._file = h5py.File(path, "r", locking=False, rdcc_nbytes=0)
        try:
            if size != manifest.n_bytes:
                raise DamagedDataError("it has another size than its manifest says")
            self.datasets = {field.name: _plain(self._file, field, len(manifest.ids)) for field in manifest.fields}
            if tuple(_hard(self._file, "ids")[:].tolist()) != manifest.ids:
                raise DamagedDataError("it holds other samples than its manifest says")
        except BaseException:
            self._file.close()
            raise

    def close(self) -> None:
        self._file.close()


class ShardFiles:
    """Open shards, the least recently used closed first."""

    def __init__(self, layout: Layout, config: StoredConfig, entries: dict[int, Entry], most_open: int) -> None:
        self._layout, self._config, self._entries = layout, config, entries
        limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
        if limit != resource.RLIM_INFINITY:
            most_open = min(most_open, limit // _SHARE_OF_LIMIT)
        self._most_open = max(1, most_open)
        self._open: OrderedDict[int, OpenShard] = OrderedDict()

    def __getitem__(self, shard: int) -> OpenShard:
        if shard in self._open:
            self._open.move_to_end(shard)
        else:
            while len(self._open) >= self._most_open:
                self._close_oldest()
            self._open[shard] = self._opened(shard)
        return self._open[shard]

    def __len__(self) -> int:
        return len(self._open)

    def close(self) -> None:
        while self._open:
            self._close_oldest()

    def _opened(self, shard: int) -> OpenShard:
        while True:
            try:
                return OpenShard(self._layout, self._config, shard, self._entries.get(shard))
            except OSError as error:
                if error.errno not in (errno.EMFILE, errno.ENFILE) or not self._open:
                    raise
                # Others in this process took the descriptors.
                self._close_oldest()

    def _close_oldest(self) -> None:
        self._open.popitem(last=False)[1].close()


def _hard(file: Any, name: str) -> Any:
    link = file.get(name, getlink=True)
    if not isinstance(link, h5py.HardLink):
        raise DamagedDataError(f"{name} is a link elsewhere; data sets contain their data")
    dataset = file[name]
    if not isinstance(dataset, h5py.Dataset) or dataset.external or dataset.is_virtual:
        raise DamagedDataError(f"{name} lies in other files; data sets contain their data")
    return dataset


def _plain(file: Any, field: Field, samples: int) -> Any:
    dataset = _hard(file, field.name)
    shape = (samples, *field.shape)
    if dataset.shape != shape or dataset.dtype != field.dtype:
        found = f"{dataset.dtype} {list(dataset.shape)}"
        raise DamagedDataError(f"{field.name} is {found}, not {field.dtype} {list(shape)}")
    properties = dataset.id.get_create_plist()
    filters = {properties.get_filter(number)[0] for number in range(properties.get_nfilters())}
    if not filters <= _FILTERS:
        # Filters are code that HDF5 would load from wherever a variable of the environment says.
        raise DamagedDataError(f"{field.name} has unknown filters {sorted(filters - _FILTERS)}")
    return dataset
