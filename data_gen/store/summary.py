"""What a data set is, how far it is, and how much disk it needs, said before it is built."""

import shutil
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from data_gen.dataset_config import DatasetConfig
from data_gen.sampler import Field
from data_gen.store.folder import load_complete, open_folder, present_shards
from data_gen.store.layout import Layout, Manifest, read_manifest
from data_gen.store.verification import check_shard
from warp_caustics.errors import DamagedDataError, ResourceError
from warp_caustics.io.atomic import PathLike

RESERVE = 1.1
"""Free space asked for, relative to the estimate."""

_OVERHEAD_PER_SHARD = 24_576
"""HDF5's headers, the manifest, and two partly filled blocks of the file system."""
_OVERHEAD_PER_ARRAY = 160
"""Chunk index and the hash in the manifest."""


@dataclass(frozen=True)
class CounterSummary:
    """A counter over all built samples."""

    mean: float
    max: float
    sample_of_max: int


@dataclass(frozen=True)
class DatasetInfo:
    """Summary of a data set.

    Attributes:
        kind: ``"denoiser"``, ``"updater"``.
        role: ``"data"``, ``"test"``.
        n_samples: of the finished data set.
        n_shards: of the finished data set.
        samples_done: built so far.
        shards_done: built so far.
        complete: finished.
        bytes: of the built shards.
        raw_bytes: of their arrays without compression.
        fingerprint: hash of the configuration.
        fields: arrays of a sample; empty where nothing is built.
        counters: name to summary.
        code_versions: version of this package to number of shards.
        devices: device to number of shards.
        compression: compression to number of shards.
    """

    kind: str
    role: str
    n_samples: int
    n_shards: int
    samples_done: int
    shards_done: int
    complete: bool
    bytes: int
    raw_bytes: int
    fingerprint: str
    fields: tuple[Field, ...]
    counters: Mapping[str, CounterSummary]
    code_versions: Mapping[str, int]
    devices: Mapping[str, int]
    compression: Mapping[str, int]


def info(directory: PathLike) -> DatasetInfo:
    """Summary from the manifests alone; arrays are not read.

    Raises:
        InputError: it is no data set.
        DamagedDataError: config.json or COMPLETE.json is broken.
    """
    layout, config = open_folder(directory)
    complete = load_complete(layout, config)
    size = raw = samples = shards = 0
    fields: tuple[Field, ...] = ()
    sums: Counter[str] = Counter()
    counts: Counter[str] = Counter()
    largest: dict[str, tuple[float, int]] = {}
    versions, devices, compression = Counter[str](), Counter[str](), Counter[str]()
    for shard in present_shards(layout, config):
        manifest, problem = check_shard(layout, config, shard)
        if manifest is None or problem is not None:
            continue
        shards += 1
        samples += len(manifest.ids)
        size += manifest.n_bytes
        raw += len(manifest.ids) * sum(field.bytes_per_sample for field in manifest.fields)
        fields = manifest.fields
        versions[manifest.code_version] += 1
        devices[manifest.device] += 1
        compression[manifest.compression] += 1
        for name, values in manifest.counters.items():
            sums[name] += sum(values)  # type: ignore[assignment]
            counts[name] += len(values)
            largest[name] = max(
                [*zip(values, manifest.ids, strict=True), *([largest[name]] if name in largest else [])]
            )
    counters = {name: CounterSummary(sums[name] / counts[name], *largest[name]) for name in sorted(largest)}
    return DatasetInfo(
        kind=str(config.tree.get("kind")),
        role=str(config.tree.get("role")),
        n_samples=config.n_samples,
        n_shards=config.n_shards,
        samples_done=samples,
        shards_done=shards,
        complete=complete is not None,
        bytes=size,
        raw_bytes=raw,
        fingerprint=config.fingerprint,
        fields=fields,
        counters=counters,
        code_versions=dict(versions),
        devices=dict(devices),
        compression=dict(compression),
    )


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
