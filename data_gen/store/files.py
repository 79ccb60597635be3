"""Open shard files for reading: few at a time, and nothing in them that points elsewhere."""

import errno
import os
import resource
from collections import OrderedDict
from typing import Any

import h5py

from data_gen.sampler import Field
from data_gen.store.folder import StoredConfig
from data_gen.store.layout import Layout, sha256
from data_gen.store.manifest import Entry, read_manifest
from warp_caustics.errors import DamagedDataError

MOST_OPEN = 64
_FILTERS = {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE}
_SHARE_OF_LIMIT = 4
"""Of the descriptors a process may have, one in so many: several data sets, pipes and libraries want some too."""


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
        # Published files never change, and locks fail on many network file systems.
        self._file = h5py.File(path, "r", locking=False, rdcc_nbytes=0)
        try:
            if os.stat(path).st_size != manifest.n_bytes:
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
