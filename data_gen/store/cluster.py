"""Build a data set on many machines with Dask: one task per shard, which may run twice without harm.

All machines must see the folder under the same path. The client holds the
folder's lock; workers write shards and manifests; the client writes COMPLETE.json.
"""

import secrets
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Any

from data_gen.dataset_config import DatasetConfig
from data_gen.sampler import SamplerFactory
from data_gen.store.builder import Check, Plan, give_up, open_build, terminated_as_exit
from data_gen.store.layout import Layout, Manifest, read_manifest, sha256
from data_gen.store.maker import ShardMaker, Task
from data_gen.store.progress import BuildReport, Progress
from data_gen.store.shard import Compression
from data_gen.store.supervise import raise_described
from data_gen.store.worker import described
from warp_caustics.errors import DamagedDataError, InputError, MismatchError, ResourceError
from warp_caustics.io.atomic import PathLike, reason

_VISIBLE_S = 60.0
"""So long a network file system may take to show a file that another machine has written."""

_makers: dict[str, ShardMaker] = {}
_making = Lock()
"""Samplers are expensive to begin with, and not made for several threads."""


@dataclass(frozen=True)
class _Job:
    """What a worker needs to know."""

    run: str
    layout: Layout
    config: DatasetConfig
    sampler_factory: SamplerFactory
    device: str
    compression: Compression


def build_on_cluster(
    directory: PathLike,
    config: DatasetConfig,
    sampler_factory: SamplerFactory,
    scheduler: str,
    *,
    device: str = "cpu",
    compression: Compression = "gzip",
    check: Check = "fast",
    preflight: bool = True,
    progress: Callable[[Progress], None] | None = None,
    notice: Callable[[str], None] | None = None,
    timeout_s: float = 60.0,
) -> BuildReport:
    """Build a data set on a Dask cluster, or continue to build it.

    Args:
        directory: its folder, on a disk that all machines share.
        config: what to build.
        sampler_factory: configuration and device to sampler; importable on the workers.
        scheduler: address (``"tcp://node:8786"``) or path of a scheduler file.
        device: of every worker.
        compression: as in :func:`data_gen.store.build`.
        check: see there.
        preflight: see there.
        progress: see there.
        notice: see there.
        timeout_s: how long to wait for the scheduler and for a first worker [s].

    Returns:
        What was done.

    Raises:
        InputError: Dask is not installed.
        ResourceError: no scheduler or no worker there.
        MismatchError, DamagedDataError: as :func:`data_gen.store.build`.
    """
    try:
        import distributed
    except ImportError as error:
        raise InputError("the package 'distributed' is not installed; pip install 'nsfc[cluster]'") from error
    root = Path(directory).absolute()
    with terminated_as_exit(), open_build(root, config, compression, check, progress, notice) as plan:
        if plan.tasks:
            with _client(distributed, scheduler, timeout_s) as client:
                _run(distributed, client, plan, sampler_factory, device, preflight)
        plan.finish()
    return plan.meter.report()


def _client(distributed: Any, scheduler: str, timeout_s: float) -> Any:
    where = {"scheduler_file": scheduler} if Path(scheduler).is_file() else {"address": scheduler}
    if "://" not in scheduler and ":" not in scheduler and "scheduler_file" not in where:
        raise InputError(f"{scheduler!r} is neither the address of a scheduler nor a scheduler file; start one")
    try:
        client = distributed.Client(**where, timeout=timeout_s)
    except (OSError, ValueError) as error:
        raise ResourceError(f"no scheduler answers at {scheduler!r} ({reason(error)}); start dask scheduler") from error
    try:
        client.wait_for_workers(1, timeout=timeout_s)
    except BaseException as error:
        client.close()
        if isinstance(error, TimeoutError):
            raise ResourceError(f"no worker came to {scheduler!r} in {timeout_s:g} s; start dask worker") from error
        raise
    return client


def _run(
    distributed: Any, client: Any, plan: Plan, sampler_factory: SamplerFactory, device: str, preflight: bool
) -> None:
    # A new name each time: results of an earlier client may linger on the cluster.
    run = f"{plan.config.fingerprint()[:12]}-{secrets.token_hex(4)}"
    job = _Job(run, plan.layout, plan.config, sampler_factory, device, plan.compression)
    answer = _result(client.submit(_fields, job, key=f"fields-{run}", pure=False))
    plan.check_fields(answer["fields"], preflight)
    plan.meter.begin()
    futures = {
        client.submit(_make, job, task, key=f"shard-{run}-{task.shard}", pure=False): task for task in plan.tasks
    }
    poisoned: dict[int, list[str]] = {}
    for future in distributed.as_completed(list(futures)):
        plan.lock.check()
        shard = futures.pop(future).shard
        try:
            answer = _result(future)
        except distributed.scheduler.KilledWorker as error:
            poisoned[shard] = [f"{reason(error)[:120]}"]
            plan.meter.note(f"shard {shard} killed its workers; given up")
            continue
        manifest = _visible(plan.layout, shard, answer["manifest"])
        plan.meter.add(len(manifest.ids), manifest.n_bytes)
        future.release()
    give_up(poisoned, plan.config)


def _result(future: Any) -> dict[str, Any]:
    """The answer of a task, its exception as the error it stands for."""
    answer: dict[str, Any] = future.result()
    if "text" in answer:
        raise_described(answer, answer["shard"])
    return answer


def _visible(layout: Layout, shard: int, digest: str) -> Manifest:
    """The manifest that a worker has written, once this machine sees it."""
    deadline, pause_s = time.monotonic() + _VISIBLE_S, 0.05
    while True:
        try:
            manifest = read_manifest(layout.manifest(shard))
        except DamagedDataError:
            manifest = None
        if manifest is not None and sha256(manifest.to_bytes()) == digest:
            return manifest
        if time.monotonic() > deadline:
            raise MismatchError(
                f"shard {shard} was built, but not in {str(layout.root)!r} as this machine sees it; "
                "use a folder that all machines share under the same path"
            )
        time.sleep(pause_s)
        pause_s = min(2 * pause_s, 2.0)


def _fields(job: _Job) -> dict[str, Any]:
    """Task: which arrays a sample has."""
    with _making:
        try:
            return {"fields": _maker(job).fields}
        except Exception as error:
            return {"shard": None, **described(error)}


def _make(job: _Job, task: Task) -> dict[str, Any]:
    """Task: a shard. Exceptions come back in words, for their classes may be unknown to the client."""
    try:
        with _making:
            maker = _maker(job)
            manifest = maker.published(task.shard)
            batch = maker.draw(task.shard) if manifest is None else None
        # In a worker of two threads one draws while the other compresses and writes.
        if batch is not None:
            manifest = maker.publish(task, batch)
        assert manifest is not None
    except Exception as error:
        return {"shard": task.shard, **described(error)}
    return {"manifest": sha256(manifest.to_bytes())}


def _maker(job: _Job) -> ShardMaker:
    if job.run not in _makers:
        _makers.clear()
        sampler = job.sampler_factory(job.config, job.device)
        _makers[job.run] = ShardMaker(job.layout, job.config, sampler, job.device, job.compression)
    return _makers[job.run]
