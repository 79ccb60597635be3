"""The parent of worker processes: hands out shards, notices deaths, gives the dead's work to others."""

import contextlib
import json
import os
import pickle
import signal
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import Any, NoReturn

from data_gen.sampler import Field
from data_gen.store.maker import Task
from data_gen.store.progress import Meter
from data_gen.store.worker import PUBLISHERS, WorkerJob, run_worker
from warp_caustics import errors
from warp_caustics.child_process import cause_of_death, end_child, start_child
from warp_caustics.errors import CausticsError, InputError, MismatchError, ResourceError
from warp_caustics.signals import deferred

DEPTH = 1 + PUBLISHERS
"""Shards in a worker's hands: one being drawn, the others being written."""
MOST_DEATHS = 3
"""A shard during which so many workers died is given up."""
START_S = 60.0
"""A worker that has yet to load its libraries is silent; on a busy machine for long."""
_POLL_S = 0.25


class WorkerError(CausticsError):
    """A sampler raised an exception nobody foresaw: a bug."""


@dataclass
class _Worker:
    number: int
    device: str
    process: SpawnProcess
    connection: Connection
    last_seen: float
    heard: bool = False
    """It has given a sign of life."""
    ready: bool = False
    begun: bool = False
    """It has begun a shard."""
    tasks: dict[int, Task] = field(default_factory=dict)
    """Handed out and not done."""
    started: dict[int, float] = field(default_factory=dict)
    """When drawing began, of those it has begun."""
    alone: bool = False
    """Its only task is a suspect."""


class Supervisor:
    """Runs tasks in spawned processes.

    Args:
        job: what every worker is told; device and parent are filled in here.
        tasks: shards to make.
        devices: one per worker.
        meter: told about finished shards and deaths.
        samples_of: number of samples of a shard.
        fields: called with the sampler's fields before the first shard is handed out.
        hang_s: a worker without a sign of life for so long is killed [s]; before its first one it has START_S.
        shard_timeout_s: a shard that takes longer has its worker killed [s]; None waits for ever.
        idle: called several times a second.
    """

    def __init__(
        self,
        job: WorkerJob,
        tasks: Sequence[Task],
        devices: Sequence[str],
        meter: Meter,
        *,
        samples_of: Callable[[int], int],
        fields: Callable[[tuple[Field, ...]], None],
        hang_s: float,
        shard_timeout_s: float | None,
        idle: Callable[[], None],
    ) -> None:
        self._job, self._devices, self._meter = job, devices, meter
        self._samples_of, self._on_fields, self._idle = samples_of, fields, idle
        self._hang_s, self._shard_timeout_s = hang_s, shard_timeout_s
        self._pending = deque(tasks)
        self._suspects: deque[Task] = deque()
        self._deaths: dict[int, list[str]] = {}
        self._deaths_at_start = 0
        self._fields: tuple[Field, ...] | None = None
        self._workers: list[_Worker] = []

    def run(self) -> dict[int, list[str]]:
        """Make all shards.

        Returns:
            Shards given up, with how their workers died.
        """
        _require_picklable(self._job)
        try:
            for number, device in enumerate(self._devices):
                self._spawn(number, device)
            while self._pending or self._suspects or any(worker.tasks for worker in self._workers):
                self._hand_out()
                self._listen()
                self._look_for_hangs()
                self._idle()
            self._dismiss()
        finally:
            self._kill_all()
        return {shard: deaths for shard, deaths in self._deaths.items() if len(deaths) >= MOST_DEATHS}

    def _spawn(self, number: int, device: str) -> None:
        job = replace(self._job, device=device, parent=os.getpid())
        with deferred(signal.SIGINT, signal.SIGTERM):
            process, connection = start_child(f"nsfc-worker-{number}", run_worker, job)
            self._workers.append(_Worker(number, device, process, connection, time.monotonic()))

    def _hand_out(self) -> None:
        for worker in self._workers:
            if not worker.ready or worker.alone:
                continue
            while self._pending and len(worker.tasks) < DEPTH:
                self._send(worker, self._pending.popleft())
            if self._suspects and not worker.tasks:
                # Alone, so that the next death has one possible cause.
                worker.alone = True
                self._send(worker, self._suspects.popleft())

    def _send(self, worker: _Worker, task: Task) -> None:
        worker.tasks[task.shard] = task
        # A worker that died a moment ago is noticed below.
        with contextlib.suppress(OSError):
            worker.connection.send_bytes(json.dumps(vars(task)).encode())

    def _listen(self) -> None:
        connections = {worker.connection: worker for worker in self._workers}
        for connection in wait(list(connections), _POLL_S):
            worker = connections[connection]  # type: ignore[index]
            try:
                while worker.connection.poll():
                    self._receive(worker, json.loads(worker.connection.recv_bytes()))
            except (EOFError, OSError):
                self._bury(worker, None)

    def _receive(self, worker: _Worker, message: dict[str, Any]) -> None:
        worker.last_seen, worker.heard = time.monotonic(), True
        event = message["event"]
        if event == "beat":
            return
        if event == "ready":
            self._greet(worker, message["fields"])
            return
        shard: int = message["shard"]
        if event == "start":
            worker.started[shard] = worker.last_seen
            worker.begun = True
            self._deaths_at_start = 0
        elif event == "done":
            del worker.tasks[shard]
            worker.started.pop(shard, None)
            worker.alone = False
            self._meter.add(self._samples_of(shard), message["bytes"])
        elif event == "error":
            raise_described(message, shard)

    def _greet(self, worker: _Worker, announced: list[dict[str, Any]]) -> None:
        fields = tuple(Field.from_record(part) for part in announced)
        if self._fields is None:
            self._on_fields(fields)
            self._meter.begin()
            self._fields = fields
        elif fields != self._fields:
            raise MismatchError(f"workers on {self._devices[0]} and {worker.device} announce different fields; use one")
        worker.ready = True

    def _look_for_hangs(self) -> None:
        now = time.monotonic()
        for worker in list(self._workers):
            limit = self._hang_s if worker.heard else max(self._hang_s, START_S)
            if now - worker.last_seen > limit:
                self._bury(worker, f"gave no sign of life for {limit:g} s")
            elif self._is_overdue(worker, now):
                self._bury(worker, f"took longer than {self._shard_timeout_s:g} s")

    def _is_overdue(self, worker: _Worker, now: float) -> bool:
        if self._shard_timeout_s is None or not worker.started:
            return False
        # The one being written may have to wait for nobody, the one being drawn for the one being written.
        return now - min(worker.started.values()) > self._shard_timeout_s * len(worker.started)

    def _bury(self, worker: _Worker, why: str | None) -> None:
        """A worker is dead, or as good as dead: blame the shards it was at, give all its work to others."""
        # A worker that closed its pipe is about to die: wait for it to say of what.
        end_child(worker.process, worker.connection, patience_s=1.0 if why is None else 0.0)
        why = why or cause_of_death(worker.process.exitcode)
        self._workers.remove(worker)
        who = f"worker {worker.number} (process {worker.process.pid}, {worker.device})"
        if not worker.begun:
            self._deaths_at_start += 1
            if self._deaths_at_start >= MOST_DEATHS:
                raise ResourceError(f"{MOST_DEATHS} workers died while starting, the last one {why}; see its messages")
        self._blame(worker, who, why)
        if self._pending or self._suspects:
            self._spawn(worker.number, worker.device)

    def _blame(self, worker: _Worker, who: str, why: str) -> None:
        for task in reversed(worker.tasks.values()):
            if task.shard not in worker.started:
                self._pending.appendleft(task)
                continue
            deaths = self._deaths.setdefault(task.shard, [])
            deaths.append(why)
            given_up = len(deaths) >= MOST_DEATHS
            if not given_up:
                self._suspects.append(task)
            what = "given up" if given_up else "made again"
            self._meter.note(f"{who} {why} at shard {task.shard}; {what} ({len(deaths)} of {MOST_DEATHS})")
        if not worker.started:
            # It may have been given shards, of which it had begun none.
            self._meter.note(f"{who} {why} {'between shards' if worker.begun else 'while starting'}; started again")

    def _dismiss(self) -> None:
        for worker in self._workers:
            with contextlib.suppress(OSError):
                worker.connection.send_bytes(b"null")
        for worker in self._workers:
            worker.process.join(timeout=2.0)

    def _kill_all(self) -> None:
        for worker in self._workers:
            worker.process.kill()
        for worker in self._workers:
            end_child(worker.process, worker.connection)


def raise_described(message: Mapping[str, Any], shard: int | None) -> NoReturn:
    """Raise what :func:`data_gen.store.worker.described` put in words."""
    kind = getattr(errors, message["kind"], WorkerError)
    text = message["text"]
    raise kind(text if shard is None or f"shard {shard}" in text else f"shard {shard}: {text}")


def _require_picklable(job: WorkerJob) -> None:
    try:
        pickle.dumps(job)
    except Exception as error:
        raise InputError(
            f"the sampler factory cannot be sent to workers ({str(error)[:120]}); "
            "give a module's function or a functools.partial of one, or use workers=0"
        ) from error
