"""One worker process: draws a shard while those before are compressed and written.

It obeys its parent and dies with it. Messages are short JSON lines, each
written to the pipe in one piece, so that a worker stopped or killed in the
middle of its work cannot leave half a message.
"""

import contextlib
import ctypes
import json
import os
import signal
import sys
import threading
import traceback
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

from data_gen.dataset_config import DatasetConfig
from data_gen.sampler import SampleBatch, SamplerFactory
from data_gen.store.layout import Layout
from data_gen.store.maker import ShardMaker, Task
from data_gen.store.shard import Compression
from warp_caustics.child_process import leave_ctrl_c_to_parent
from warp_caustics.errors import CausticsError, ResourceError
from warp_caustics.io.atomic import reason

BEAT_S = 0.5
PUBLISHERS = 2
"""Threads that publish: one compresses while the other waits for the disk."""

_PR_SET_PDEATHSIG = 1
_MOST_TEXT = 400


@dataclass(frozen=True)
class WorkerJob:
    """What a worker is told when it starts."""

    layout: Layout
    config: DatasetConfig
    sampler_factory: SamplerFactory
    device: str
    compression: Compression
    threads: int
    parent: int


def run_worker(connection: Connection, job: WorkerJob) -> None:
    """Entry point of the process."""
    _die_with_parent(job.parent)
    leave_ctrl_c_to_parent()
    line = _Line(connection)
    threading.Thread(target=line.beat, name="beat", daemon=True).start()
    try:
        sampler = job.sampler_factory(job.config, job.device)
        with ShardMaker(job.layout, job.config, sampler, job.device, job.compression, job.threads) as maker:
            line.send(event="ready", fields=[field.record() for field in maker.fields])
            _serve(line, connection, maker)
    except EOFError:
        pass
    except BaseException as error:
        line.send(event="error", shard=None, **described(error))
    finally:
        # Not through the interpreter's shutdown: threads of a sampler may never end.
        _leave()


def described(error: BaseException) -> dict[str, str]:
    """An exception in words that another process understands."""
    known = isinstance(error, CausticsError)
    memory = isinstance(error, MemoryError) or type(error).__name__ == "OutOfMemoryError"
    text = str(error) if known else f"{type(error).__name__}: {reason(error)}"
    frames = traceback.extract_tb(error.__traceback__)
    if memory:
        text += "; take fewer samples per shard, fewer workers, or smaller images"
    elif not known and frames:
        text += f" ({os.path.basename(frames[-1].filename)}:{frames[-1].lineno})"
    kind = type(error).__name__ if known else ResourceError.__name__ if memory else ""
    return {"kind": kind, "text": text[:_MOST_TEXT]}


class _Line:
    """The way to the parent, shared by its threads."""

    def __init__(self, connection: Connection) -> None:
        self._connection, self._lock = connection, threading.Lock()

    def send(self, **message: Any) -> None:
        with self._lock, contextlib.suppress(OSError):
            self._connection.send_bytes(json.dumps(message).encode())

    def beat(self) -> None:
        pause = threading.Event()
        while not pause.wait(BEAT_S):
            self.send(event="beat")


def _serve(line: _Line, connection: Connection, maker: ShardMaker) -> None:
    with ThreadPoolExecutor(PUBLISHERS) as publisher:
        while True:
            message = json.loads(connection.recv_bytes())
            if message is None:
                return
            task = Task(**message)
            line.send(event="start", shard=task.shard)
            try:
                batch = maker.draw(task.shard)
            except Exception as error:
                line.send(event="error", shard=task.shard, **described(error))
                return
            publisher.submit(_publish, line, maker, task, batch)


def _publish(line: _Line, maker: ShardMaker, task: Task, batch: SampleBatch) -> None:
    try:
        manifest = maker.publish(task, batch)
        line.send(event="done", shard=task.shard, bytes=manifest.n_bytes)
    except Exception as error:
        line.send(event="error", shard=task.shard, **described(error))


def _die_with_parent(parent: int) -> None:
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    # The parent may have died before the line above.
    if os.getppid() != parent:
        _leave()


def _leave() -> None:
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(0)
