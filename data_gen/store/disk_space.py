"""How much disk a data set needs, said before it is built."""

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from data_gen.dataset_config import DatasetConfig
from data_gen.sampler import Field
from data_gen.store.layout import Layout
from data_gen.store.manifest import Manifest, read_manifest
from warp_caustics.errors import DamagedDataError, ResourceError
from warp_caustics.io.atomic import PathLike

RESERVE = 1.1
"""Free space asked for, relative to the estimate."""

_OVERHEAD_PER_SHARD = 24_576
"""HDF5's headers, the manifest, and two partly filled blocks of the file system."""
_OVERHEAD_PER_ARRAY = 160
"""Chunk index and the hash in the manifest."""


@dataclass(frozen=True)
class Estimate:
    """What a build will take.

    Attributes:
        bytes_total: of the finished data set.
        bytes_missing: of the shards not built yet.
        shards_total: shards of the finished data set.
        shards_missing: shards not built yet.
        free_bytes: on the disk now.
        measured: the size comes from a built shard; otherwise from the arrays without compression.
    """

    bytes_total: int
    bytes_missing: int
    shards_total: int
    shards_missing: int
    free_bytes: int
    measured: bool

    def require(self) -> None:
        """Refuse a build that the disk cannot hold.

        Raises:
            ResourceError: says how much is missing.
        """
        needed = int(self.bytes_missing * RESERVE)
        if needed > self.free_bytes:
            basis = "measured" if self.measured else "without compression"
            raise ResourceError(
                f"the build needs about {self.bytes_missing:,} bytes ({basis}), {needed:,} with reserve, and "
                f"{self.free_bytes:,} are free; free space, choose another disk, or switch this check off"
            )


def estimate(
    directory: PathLike, config: DatasetConfig, fields: Sequence[Field], *, missing: Sequence[int] | None = None
) -> Estimate:
    """Disk space of a data set, before or while it is built.

    Args:
        directory: where it is or will be.
        config: what it is.
        fields: arrays of a sample.
        missing: shards not built yet; found by looking for manifests if None.
    """
    layout = Layout(Path(directory))
    if missing is None:
        missing = [shard for shard in range(config.n_shards) if not layout.manifest(shard).exists()]
    built = _first_built(layout, config, set(missing))
    per_sample = _bytes_per_sample(fields, built)
    missing_samples = sum(len(config.shard_ids(shard)) for shard in missing)
    overhead = 0 if built else _OVERHEAD_PER_SHARD
    folder = layout.root
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return Estimate(
        bytes_total=int(config.n_samples * per_sample) + config.n_shards * overhead,
        bytes_missing=int(missing_samples * per_sample) + len(missing) * overhead,
        shards_total=config.n_shards,
        shards_missing=len(missing),
        free_bytes=shutil.disk_usage(folder).free,
        measured=built is not None,
    )


def _bytes_per_sample(fields: Sequence[Field], built: Manifest | None) -> float:
    if built is not None:
        return (built.n_bytes + len(built.to_bytes()) + 4096) / len(built.ids)
    return sum(field.bytes_per_sample + _OVERHEAD_PER_ARRAY for field in fields)


def _first_built(layout: Layout, config: DatasetConfig, missing: set[int]) -> Manifest | None:
    for shard in range(config.n_shards):
        if shard not in missing:
            try:
                manifest = read_manifest(layout.manifest(shard))
            except DamagedDataError:
                continue
            if manifest is not None and manifest.fingerprint == config.fingerprint():
                return manifest
    return None
