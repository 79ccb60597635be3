"""Workers of a search: this process, or several that it starts, watches and replaces."""

import contextlib
import multiprocessing
import os
import secrets
import signal
import socket
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from pathlib import Path
from typing import Any

import optuna

from nets.search.config import SearchConfig
from nets.search.objective import MakeObjective, TrainingObjective
from nets.search.report import write_outputs
from nets.search.signals import check_stopped, signals_wait
from nets.search.study import Address, abandon, count, open_study
from nets.search.worker import Goal, Worker
from nets.training.keys import step_seed
from warp_caustics.child_process import cause_of_death, end_child, leave_ctrl_c_to_parent, start_child
from warp_caustics.errors import EXIT_INTERRUPTED, CausticsError, ResourceError

POLL_S = 0.3
MAX_IDLE_DEATHS = 2
"""A worker that dies before it has begun a trial, time after time, is not started again."""
STOP_WAIT_S = 30.0
"""For workers to end their step after a signal, before they are killed."""


@dataclass(frozen=True)
class Plan:
    """What every worker is told; it can be sent to another process.

    Attributes:
        where: the study is.
        search: what is searched.
        goal: when to end.
        folder: for outputs.
        seed: of which each worker's sampler gets a part of its own.
        make_objective: makes what judges a trial.
    """

    where: Address
    search: SearchConfig
    goal: Goal
    folder: Path
    seed: int = 0
    make_objective: MakeObjective = TrainingObjective


@dataclass
class _Slot:
    """A worker's place: processes come and go."""

    number: int
    device: str
    name: str = ""
    process: SpawnProcess | None = None
    pipe: Connection | None = None
    idle_deaths: int = 0
    problem: str = ""


def run_here(plan: Plan, device: str, show: Callable[[optuna.Study], None]) -> None:
    """Search in this process.

    Args:
        plan: of the search.
        device: to train on.
        show: called with the study after every trial.

    Raises:
        KeyboardInterrupt: Ctrl-C or SIGTERM.
        CausticsError: as :class:`Worker` and :func:`open_study`.
    """
    _work(plan, 0, device, _worker_name(0), show)


def run_workers(plan: Plan, devices: list[str], show: Callable[[optuna.Study], None]) -> None:
    """Search in several processes, one per entry of ``devices``.

    A process that dies has its trial queued again and is replaced. Arguments and
    errors as of :func:`run_here`.

    Raises:
        ResourceError: all workers are gone and the goal is not reached.
    """
    study = open_study(plan.where, plan.search)
    with signals_wait():
        _supervise(plan, devices, study, show)


def _supervise(plan: Plan, devices: list[str], study: optuna.Study, show: Callable[[optuna.Study], None]) -> None:
    slots = [_Slot(number, device) for number, device in enumerate(devices)]
    try:
        for slot in slots:
            _start(plan, slot)
        while any(slot.process is not None for slot in slots):
            time.sleep(POLL_S)
            check_stopped()
            for slot in slots:
                if slot.process is not None and slot.process.exitcode is not None:
                    _ended(plan, slot, study)
            show(study)
            deadline = plan.goal.deadline
            if deadline is not None and time.monotonic() > deadline + STOP_WAIT_S:
                break  # workers see to it themselves, but not while they make samples
    finally:
        _stop(slots, study)
        show(study)
    left = plan.goal.n_trials - count(study).finished
    if left > 0 and not plan.goal.is_late():
        problem = next((slot.problem for slot in slots if slot.problem), "killed")
        raise ResourceError(f"all {len(slots)} workers ended, {left} trials are left; the first problem: {problem}")


def sampler_seed(seed: int, slot: int, trials: int) -> int:
    """Seed of a worker's sampler below 2^32: another on each machine, in each place, and after each restart."""
    return step_seed(seed, f"sampler/{socket.gethostname()}/{slot}", trials) % 2**32


def _worker_name(slot: int) -> str:
    return f"{socket.gethostname()}/{slot}/{secrets.token_hex(4)}"


def _work(plan: Plan, slot: int, device: str, name: str, show: Callable[[optuna.Study], None]) -> None:
    objective: Any = plan.make_objective(plan.search, device, plan.goal.deadline)
    study = open_study(plan.where, plan.search)
    seed = sampler_seed(plan.seed, slot, len(study.get_trials(deepcopy=False)))
    study = open_study(plan.where, plan.search, seed)

    def after_trial(study: optuna.Study) -> None:
        write_outputs(plan.folder, study, plan.search)
        show(study)

    worker = Worker(
        study,
        objective,
        plan.goal,
        name=name,
        folder=plan.folder,
        grace_s=plan.where.grace_s,
        after_trial=after_trial,
        seed=seed,
    )
    try:
        worker.run()
    finally:
        if hasattr(objective, "close"):
            objective.close()


# --------------------------------------------------------------------------- in the parent


def _start(plan: Plan, slot: _Slot) -> None:
    slot.name = _worker_name(slot.number)
    arguments = (plan, slot.number, slot.device, slot.name)
    slot.process, slot.pipe = start_child(f"search-{slot.number}", _child, *arguments)


def _ended(plan: Plan, slot: _Slot, study: optuna.Study) -> None:
    """Clear up after a process, and start the next one where there is work."""
    assert slot.process is not None and slot.pipe is not None
    code, slot.process = slot.process.exitcode, None
    told = ""
    with contextlib.suppress(EOFError, OSError):  # it was killed
        told = slot.pipe.recv() if slot.pipe.poll() else ""
    slot.pipe.close()
    abandon(study, slot.name)
    if code == 0:
        return
    trials = study.get_trials(deepcopy=False)
    slot.problem = told or f"worker {slot.number} {cause_of_death(code)}"
    has_begun = any(trial.user_attrs.get("worker") == slot.name for trial in trials)
    slot.idle_deaths = 0 if has_begun else slot.idle_deaths + 1
    is_hopeless = slot.idle_deaths >= MAX_IDLE_DEATHS or (told and code != ResourceError.exit_code)
    if not is_hopeless and not plan.goal.is_late() and count(study).finished < plan.goal.n_trials:
        _start(plan, slot)


def _stop(slots: list[_Slot], study: optuna.Study) -> None:
    alive = [slot for slot in slots if slot.process is not None]
    for slot in alive:
        assert slot.process is not None
        slot.process.terminate()
    deadline = time.monotonic() + STOP_WAIT_S
    for slot in alive:
        assert slot.process is not None and slot.pipe is not None
        end_child(slot.process, slot.pipe, patience_s=max(0.1, deadline - time.monotonic()))
        abandon(study, slot.name)


# --------------------------------------------------------------------------- in the child


def _child(pipe: Connection, plan: Plan, slot: int, device: str, name: str) -> None:
    # Ctrl-C on the terminal is for the parent, which passes it on as SIGTERM.
    os.setpgid(0, 0)
    leave_ctrl_c_to_parent()
    signal.signal(signal.SIGTERM, _as_interrupt)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        _prepare(device)
        _work(plan, slot, device, name, lambda study: None)
    except KeyboardInterrupt:
        raise SystemExit(EXIT_INTERRUPTED) from None
    except CausticsError as error:
        pipe.send(str(error))
        raise SystemExit(error.exit_code) from None
    except Exception as error:
        pipe.send(f"{type(error).__name__}: {' '.join(str(error).split())[:200]}")
        raise


def _prepare(device: str) -> None:
    import torch

    from warp_caustics.kernels.runtime import start_warp

    start_warp()
    if device == "cpu":
        # Workers are the parallelism; threads of several of them would only wait for each other.
        torch.set_num_threads(1)


def _as_interrupt(signum: int, frame: Any) -> None:
    raise KeyboardInterrupt("terminated")


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os.kill(os.getpid(), signal.SIGTERM)
