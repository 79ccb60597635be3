"""Processes of one's own: begun, ended, and what they died of.

Who gets which work, and what a death means for it, is the supervisor's business.
"""

import multiprocessing
import signal
from collections.abc import Callable
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from typing import Any

_SPAWN = multiprocessing.get_context("spawn")
"""CUDA and HDF5 do not survive a fork."""


def start_child(name: str, target: Callable[..., Any], *arguments: Any) -> tuple[SpawnProcess, Connection]:
    """A process, and this end of a pipe to it.

    Until the child calls :func:`leave_ctrl_c_to_parent` a Ctrl-C waits for it. Call this, and note the process down,
    inside :func:`warp_caustics.signals.deferred`: a process that nobody knows of is ended by nobody, and the
    interpreter waits for it when it ends.

    Args:
        name: of the process.
        target: called with the other end of the pipe and the arguments; a module's function.
        arguments: can be pickled.
    """
    ours, theirs = _SPAWN.Pipe()
    process = _SPAWN.Process(target=target, args=(theirs, *arguments), name=name)
    # The mask is inherited.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        process.start()
    finally:
        # With this copy closed, the child's death ends the pipe.
        theirs.close()
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    return process, ours


def leave_ctrl_c_to_parent() -> None:
    """In a child: Ctrl-C reaches the whole foreground group; the parent decides what becomes of its children."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


def end_child(process: SpawnProcess, connection: Connection, patience_s: float = 0.0) -> None:
    """Wait for the end of a process, and then make one.

    Args:
        process: may have ended.
        connection: to it; closed.
        patience_s: before it is killed [s].
    """
    process.join(timeout=patience_s)
    process.kill()
    process.join()
    connection.close()


def cause_of_death(exit_code: int | None) -> str:
    """How a process ended, for people."""
    if exit_code is not None and exit_code < 0:
        try:
            return f"died of {signal.Signals(-exit_code).name}"
        except ValueError:
            return f"died of signal {-exit_code}"
    return f"ended with exit code {exit_code}"
