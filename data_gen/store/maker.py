"""From a shard's number to a published shard: what every worker, thread and cluster task does."""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

from data_gen.dataset_config import DatasetConfig
from data_gen.sampler import SampleBatch, Sampler
from data_gen.store.layout import (
    Layout,
    Manifest,
    canonical_json,
    code_version,
    library_versions,
    read_manifest,
    sha256,
)
from data_gen.store.shard import Compression, check_fields, encode_shard
from warp_caustics.errors import DamagedDataError, MismatchError
from warp_caustics.io.durable import publish


@dataclass(frozen=True)
class Task:
    """One shard to make.

    Attributes:
        shard: its number.
        reread: read it back from the disk before it gets its name.
    """

    shard: int
    reread: bool = False


class ShardMaker:
    """Draws, checks and publishes shards of one data set.

    Args:
        layout: where to.
        config: what.
        sampler: makes the samples.
        device: the sampler's, recorded in the manifest.
        compression: see :func:`data_gen.store.shard.encode_shard`.
        threads: for hashing and compression; all cores if None.
    """

    def __init__(
        self,
        layout: Layout,
        config: DatasetConfig,
        sampler: Sampler,
        device: str,
        compression: Compression = "gzip",
        threads: int | None = None,
    ) -> None:
        self._layout, self._config, self._sampler = layout, config, sampler
        self._device, self._compression = device, compression
        self._fingerprint = config.fingerprint()
        self._versions = code_version(), library_versions()
        self._pool = ThreadPoolExecutor(threads or usable_cores())
        self.fields = tuple(sampler.fields)
        check_fields(self.fields, compression)

    def __enter__(self) -> "ShardMaker":
        return self

    def __exit__(self, *exception: Any) -> None:
        self._pool.shutdown(cancel_futures=True)

    def make(self, task: Task) -> Manifest:
        """Draw and publish."""
        return self.published(task.shard) or self.publish(task, self.draw(task.shard))

    def draw(self, shard: int) -> SampleBatch:
        """The samples of a shard."""
        return self._sampler.draw(self._config.shard_ids(shard))

    def publish(self, task: Task, batch: SampleBatch) -> Manifest:
        """Write the shard, then its manifest. Where both are there already nothing happens.

        Raises:
            MismatchError: the shard was published before, with other samples.
            InputError: the samples are not what the sampler announced.
            ResourceError: the disk is full or broken.
        """
        shard, ids = task.shard, tuple(self._config.shard_ids(task.shard))
        encoded = encode_shard(
            batch,
            self.fields,
            shard=shard,
            ids=ids,
            fingerprint=self._fingerprint,
            config=canonical_json(self._config.canonical()),
            compression=self._compression,
            pool=self._pool,
        )
        version, libraries = self._versions
        manifest = Manifest(
            shard=shard,
            n_bytes=len(encoded.data),
            sha256=sha256(encoded.data),
            fingerprint=self._fingerprint,
            ids=ids,
            samples=encoded.samples,
            counters={name: tuple(float(x) for x in batch.counters[name]) for name in sorted(batch.counters)},
            fields=self.fields,
            compression=self._compression,
            device=self._device,
            code_version=version,
            libraries=libraries,
        )
        # A task may run twice: on a worker that was thought lost, and on its successor.
        if (published := self.published(shard)) is not None:
            return published
        self._check_reproduced(manifest)
        publish(self._layout.shard(shard), encoded.data, reread=task.reread)
        publish(self._layout.manifest(shard), manifest.to_bytes(), reread=task.reread)
        return manifest

    def published(self, shard: int) -> Manifest | None:
        """Manifest of a shard that is there already, as far as its size tells."""
        manifest = self._earlier(shard)
        try:
            whole = manifest is not None and self._layout.shard(shard).stat().st_size == manifest.n_bytes
        except FileNotFoundError:
            whole = False
        return manifest if whole else None

    def _earlier(self, shard: int) -> Manifest | None:
        try:
            manifest = read_manifest(self._layout.manifest(shard))
        except DamagedDataError:
            return None
        matches = manifest is not None and (manifest.shard, manifest.fingerprint) == (shard, self._fingerprint)
        return manifest if matches else None

    def _check_reproduced(self, manifest: Manifest) -> None:
        earlier = self._earlier(manifest.shard)
        # GPUs add in whatever order; and other versions of zlib or HDF5 may spell the same samples differently.
        if earlier is None or {earlier.device, manifest.device} != {"cpu"} or earlier.samples == manifest.samples:
            return
        versions = sorted(
            f"{name} {earlier.libraries.get(name)} -> {manifest.libraries.get(name)}"
            for name in {*earlier.libraries, *manifest.libraries}
            if earlier.libraries.get(name) != manifest.libraries.get(name)
        )
        raise MismatchError(
            f"shard {manifest.shard} is not reproducible: its samples were {_short(earlier)} and are now "
            f"{_short(manifest)} ({', '.join(versions) or 'same library versions'}); "
            "make the sampler depend on configuration and id only, or build into a new folder"
        )


def usable_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _short(manifest: Manifest) -> str:
    return sha256(canonical_json(manifest.samples))[:12]
