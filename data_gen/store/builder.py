"""Build a data set on this machine: what is missing, nothing twice, from any state a crash may have left."""

import hashlib
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from data_gen.dataset_config import DatasetConfig
from data_gen.sampler import Field, SamplerFactory
from data_gen.store.folder import (
    REPAIRED_BY_BUILD,
    StoredConfig,
    check_same_origin,
    load_complete,
    prepare_folder,
    refuse_strangers,
)
from data_gen.store.layout import Complete, Layout, Manifest
from data_gen.store.lock import BuildLock
from data_gen.store.maker import ShardMaker, Task, usable_cores
from data_gen.store.progress import BuildReport, Meter, Progress
from data_gen.store.shard import Compression
from data_gen.store.summary import estimate
from data_gen.store.supervise import Supervisor
from data_gen.store.verification import Problem, check_shard
from data_gen.store.worker import WorkerJob
from warp_caustics.errors import EXIT_TERMINATED, DamagedDataError, InputError
from warp_caustics.io.atomic import PathLike
from warp_caustics.io.durable import make_folder, publish, remove, sweep
from warp_caustics.signals import Restore, answered

Check = Literal["fast", "full"]

HANG_S = 60.0
_REREAD_ONE_IN = 100
_CHECKING_THREADS = 4


def build(
    directory: PathLike,
    config: DatasetConfig,
    sampler_factory: SamplerFactory,
    *,
    workers: int = 0,
    devices: Sequence[str] = ("cpu",),
    compression: Compression = "gzip",
    check: Check = "fast",
    preflight: bool = True,
    progress: Callable[[Progress], None] | None = None,
    notice: Callable[[str], None] | None = None,
    hang_s: float = HANG_S,
    shard_timeout_s: float | None = None,
) -> BuildReport:
    """Build a data set, or continue to build it.

    Args:
        directory: its folder; made if it is missing, its parent must exist.
        config: what to build; must be the one the folder was begun with.
        sampler_factory: configuration and device to sampler; picklable where there are workers.
        workers: processes. 0 builds in this process, one shard after the other; with 1 or more, drawing overlaps
            with compressing and writing, and a crash of a worker costs its shard only. At least one per device.
        devices: ``"cpu"``, ``"cuda:0"`` ...; workers take them in turn.
        compression: ``"gzip"`` or ``"none"``.
        check: ``"fast"`` takes shards as built whose file has the manifest's size; ``"full"`` hashes every file.
            Damaged shards are made again, to the same bytes.
        preflight: refuse to start when the disk cannot hold the data set.
        progress: called with the state after each shard.
        notice: called with one line for each thing that went wrong and was mended.
        hang_s: a worker without a sign of life for so long is replaced [s]; 60 s at least where it has yet to start.
        shard_timeout_s: so is one that takes longer for a shard [s]; None waits for ever.

    Returns:
        What was done.

    Raises:
        MismatchError: the folder holds another data set, somebody else builds it, or a shard came out differently.
        ResourceError: the disk is full, too small or broken.
        DamagedDataError: shards during which workers died again and again; all others are built.
        InputError: a value that cannot be used, or a sampler that returns something else than it announces.
    """
    if workers < 0 or not devices:
        raise InputError(f"{workers} workers, {len(devices)} devices; give at least 0 and 1")
    with terminated_as_exit(), open_build(directory, config, compression, check, progress, notice) as plan:
        if plan.tasks and workers == 0:
            _run_here(plan, sampler_factory, devices[0], preflight)
        elif plan.tasks:
            _run_workers(plan, sampler_factory, workers, devices, preflight, hang_s, shard_timeout_s)
        plan.finish()
    return plan.meter.report()


@dataclass(frozen=True)
class Plan:
    """A build with the lock held.

    Attributes:
        layout: where.
        config: what.
        compression: how.
        tasks: shards to make.
        built: one manifest of those that are there, None where nothing is.
        meter: progress.
        lock: held.
    """

    layout: Layout
    config: DatasetConfig
    compression: Compression
    tasks: tuple[Task, ...]
    built: Manifest | None
    meter: Meter
    lock: BuildLock

    def check_fields(self, fields: Sequence[Field], preflight: bool) -> None:
        """Compare with what is there, and with the free disk.

        Raises:
            MismatchError: shards have other fields.
            ResourceError: the disk is too small.
        """
        if self.built is not None:
            check_same_origin(self.built, self.compression, fields)
        if preflight:
            missing = [task.shard for task in self.tasks]
            estimate(self.layout.root, self.config, fields, missing=missing).require()

    def finish(self) -> None:
        """Write COMPLETE.json.

        Raises:
            DamagedDataError: a shard is missing after all.
        """
        stored = _stored(self.config)
        manifests = []
        for shard in range(self.config.n_shards):
            manifest, problem = check_shard(self.layout, stored, shard)
            if manifest is None or problem is not None:
                raise DamagedDataError(f"{problem or shard}; run the same command again to resume")
            manifests.append(manifest)
        self.lock.check()
        complete = Complete.of(self.config.fingerprint(), manifests).to_bytes()
        if not self.layout.complete.exists():
            publish(self.layout.complete, complete, reread=True)


@contextmanager
def open_build(
    directory: PathLike,
    config: DatasetConfig,
    compression: Compression,
    check: Check,
    progress: Callable[[Progress], None] | None,
    notice: Callable[[str], None] | None,
) -> Iterator[Plan]:
    """Lock and prepare the folder, find what is to be done, and sweep temporary files at the end."""
    root = Path(directory)
    make_folder(root)
    layout = Layout(root)
    # A lock is a file that is written to: not before the folder is known as a data set's.
    refuse_strangers(layout)
    with BuildLock(layout.lock) as lock:
        prepare_folder(root, config)
        sweep(layout.root, layout.shards)
        try:
            notes: list[str] = []
            tasks, built = _to_do(layout, config, compression, check, notes)
            done = config.n_samples - sum(len(config.shard_ids(task.shard)) for task in tasks)
            meter = Meter(done, config.n_samples, progress, notice)
            for note in notes:
                meter.note(note)
            yield Plan(layout, config, compression, tasks, built, meter, lock)
        finally:
            if not lock.lost:
                sweep(layout.root, layout.shards)


def give_up(poisoned: dict[int, list[str]], config: DatasetConfig) -> None:
    """Name shards that kill whoever makes them.

    Raises:
        DamagedDataError: if there is one.
    """
    if poisoned:
        listed = "; ".join(
            f"shard {shard} (samples {config.shard_ids(shard)[0]} to {config.shard_ids(shard)[-1]}): "
            f"{', '.join(deaths)}"
            for shard, deaths in sorted(poisoned.items())[:3]
        )
        more = f"; and {len(poisoned) - 3} more" if len(poisoned) > 3 else ""
        raise DamagedDataError(
            f"{len(poisoned)} of {config.n_shards} shards could not be made, their workers died each time: "
            f"{listed}{more}; all others are built, run the same command again to retry these"
        )


def _to_do(
    layout: Layout, config: DatasetConfig, compression: Compression, check: Check, notes: list[str]
) -> tuple[tuple[Task, ...], Manifest | None]:
    """Shards to make, and a manifest of those that are there. Damaged shards are removed."""
    stored = _stored(config)
    built: dict[tuple[str, str], Manifest] = {}
    problems: dict[int, tuple[Problem, bool]] = {}
    try:
        complete = load_complete(layout, stored)
    except DamagedDataError as error:
        notes.append(f"{str(error).removesuffix(REPAIRED_BY_BUILD)}; written again")
        complete = None

    def look(shard: int) -> tuple[Manifest | None, Problem | None]:
        entry = complete.entries[shard] if complete and shard < len(complete.entries) else None
        return check_shard(layout, stored, shard, entry=entry, full=check == "full")

    with ThreadPoolExecutor(_CHECKING_THREADS) as pool:
        states = list(pool.map(look, range(config.n_shards)))
    for shard, (manifest, problem) in enumerate(states):
        if problem is not None:
            problems[shard] = problem, manifest is not None
        elif manifest is not None:
            built.setdefault((manifest.code_version, manifest.compression), manifest)
    if problems:
        for manifest in built.values():
            check_same_origin(manifest, compression)
    if (complete is None or problems) and layout.complete.exists():
        # First of all: from here on the data set is not finished.
        remove(layout.complete)
    for problem, has_manifest in problems.values():
        _clear(layout, problem, has_manifest, notes)
    reread = {shard for shard in problems if _is_reread(config.fingerprint(), shard)} | set(sorted(problems)[:1])
    tasks = tuple(Task(shard, shard in reread) for shard in sorted(problems))
    return tasks, next(iter(built.values()), None)


def _clear(layout: Layout, problem: Problem, has_manifest: bool, notes: list[str]) -> None:
    shard = problem.shard
    if shard is None or problem.kind in ("missing", "unpublished"):
        return
    notes.append(f"{problem}; made again")
    if problem.kind == "stale" or not has_manifest:
        remove(layout.manifest(shard))
    # Otherwise the manifest stays: what is made again must match it.
    remove(layout.shard(shard))


def _run_here(plan: Plan, sampler_factory: SamplerFactory, device: str, preflight: bool) -> None:
    sampler = sampler_factory(plan.config, device)
    with ShardMaker(plan.layout, plan.config, sampler, device, plan.compression) as maker:
        plan.check_fields(maker.fields, preflight)
        plan.meter.begin()
        for task in plan.tasks:
            plan.lock.check()
            manifest = maker.make(task)
            plan.meter.add(len(manifest.ids), manifest.n_bytes)


def _run_workers(
    plan: Plan,
    sampler_factory: SamplerFactory,
    workers: int,
    devices: Sequence[str],
    preflight: bool,
    hang_s: float,
    shard_timeout_s: float | None,
) -> None:
    count = min(max(workers, len(devices)), len(plan.tasks))
    threads = max(1, usable_cores() // count)
    job = WorkerJob(plan.layout, plan.config, sampler_factory, devices[0], plan.compression, threads, parent=0)
    supervisor = Supervisor(
        job,
        plan.tasks,
        [devices[number % len(devices)] for number in range(count)],
        plan.meter,
        samples_of=lambda shard: len(plan.config.shard_ids(shard)),
        fields=lambda fields: plan.check_fields(fields, preflight),
        hang_s=hang_s,
        shard_timeout_s=shard_timeout_s,
        idle=plan.lock.check,
    )
    give_up(supervisor.run(), plan.config)


def _is_reread(fingerprint: str, shard: int) -> bool:
    digest = hashlib.sha256(f"{fingerprint}/reread/{shard}".encode()).digest()
    return int.from_bytes(digest[:8], "little") % _REREAD_ONE_IN == 0


def _stored(config: DatasetConfig) -> StoredConfig:
    return StoredConfig(config.canonical(), config.fingerprint())


@contextmanager
def terminated_as_exit() -> Iterator[None]:
    """SIGTERM ends the build through its clean-up, unless somebody else looks after it."""
    if signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL:
        yield
        return

    def stop(number: int, restore: Restore) -> None:
        # A second one ends the process at once.
        restore()
        raise SystemExit(EXIT_TERMINATED)

    with answered(stop, signal.SIGTERM):
        yield
