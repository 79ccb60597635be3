"""What a data set is and how far it is."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

from data_gen.sampler import Field
from data_gen.store.folder import load_complete, open_folder
from data_gen.store.verification import check_shard
from warp_caustics.io.atomic import PathLike


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
    complete = load_complete(layout, config.fingerprint)
    size = raw = samples = shards = 0
    fields: tuple[Field, ...] = ()
    sums: Counter[str] = Counter()
    counts: Counter[str] = Counter()
    largest: dict[str, tuple[float, int]] = {}
    versions, devices, compression = Counter[str](), Counter[str](), Counter[str]()
    for shard in range(config.n_shards):
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
