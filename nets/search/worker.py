"""The loop of one worker: take a trial, train, until the study has as many as were asked for."""

import fcntl
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import optuna
from optuna.trial import FrozenTrial, TrialState

from nets.search.objective import Objective, free_memory, guarded
from nets.search.signals import check_stopped, signals_wait
from nets.search.study import Counts, abandon, count, reap, retried_numbers, retry
from warp_caustics.errors import InputError, ResourceError

POLL_S = 0.5
"""How often a worker that waits for the others looks again."""
MAX_FAILURES = 5
"""Failed trials in a row that end a worker: it is not the networks' fault then."""


@dataclass(frozen=True)
class Goal:
    """When a worker ends.

    Attributes:
        n_trials: finished trials of the study, whoever ran them.
        deadline: ``time.monotonic()`` from which no trial is begun; None for never.
    """

    n_trials: int
    deadline: float | None = None

    def is_late(self) -> bool:
        return self.deadline is not None and time.monotonic() >= self.deadline


class FileLock:
    """Lock between the processes of one machine; a process that dies lets go of it.

    The kernel wakes who waits, in turn; the package filelock looks again every 50 ms, and who looks first wins.

    Args:
        path: of a file that is created and stays.
    """

    def __init__(self, path: Path):
        self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o644)

    def acquire(self) -> None:
        fcntl.flock(self._file, fcntl.LOCK_EX)

    def release(self) -> None:
        """Let go; harmless where it is not held."""
        fcntl.flock(self._file, fcntl.LOCK_UN)

    def close(self) -> None:
        os.close(self._file)


class Worker:
    """One process's part of a search.

    Args:
        study: opened by this process.
        objective: of a trial.
        goal: when to end.
        name: unlike that of any other worker.
        folder: of the search.
        grace_s: as of the study's address.
        after_trial: called with the study after each trial that this worker ended.
        seed: of the sampler, recorded.
    """

    def __init__(
        self,
        study: optuna.Study,
        objective: Objective,
        goal: Goal,
        *,
        name: str,
        folder: Path,
        grace_s: float,
        after_trial: Callable[[optuna.Study], None],
        seed: int = 0,
    ):
        self.study, self.goal, self.name, self.grace_s, self.seed = study, goal, name, grace_s, seed
        self.objective, self.after_trial = guarded(objective), after_trial
        self.claims = FileLock(folder / ".claims.lock")
        self.failures = 0
        self.current: int | None = None

    def run(self) -> None:
        """Work until the goal is reached.

        Raises:
            KeyboardInterrupt: Ctrl-C or SIGTERM; the trial is failed and queued again.
            InputError: trial after trial fails.
            ResourceError: the device needs a new process.
        """
        with signals_wait():
            self._run()

    def _run(self) -> None:
        try:
            while not self.goal.is_late():
                check_stopped()
                reap(self.study, self.grace_s)
                if count(self.study).finished >= self.goal.n_trials:
                    break
                if not self._one_trial():
                    time.sleep(POLL_S)
        except KeyboardInterrupt:
            self._queue_again()
            raise
        finally:
            self.claims.release()
            self.claims.close()
            abandon(self.study, self.name)

    def _one_trial(self) -> bool:
        """Run a trial; False if those that are left are in other hands."""
        # Until the trial is begun nobody else on this machine may count, or both would begin the last one.
        self.claims.acquire()
        try:
            if not _is_one_left(count(self.study), self.goal.n_trials):
                return False
            self.study.optimize(self._begun, n_trials=1, catch=(Exception,))
        except Exception:
            # Errors of a training do not come here. Did this machine sleep, and its trial was given away?
            if not self._was_given_away():
                raise
            return True
        finally:
            self.claims.release()
        free_memory()
        number, self.current = self.current, None
        if number is not None:
            self._check(self.study.get_trials(deepcopy=False)[number])
        self.after_trial(self.study)
        return True

    def _begun(self, trial: optuna.Trial) -> float:
        self.current = trial.number
        trial.set_user_attr("worker", self.name)
        trial.set_user_attr("sampler_seed", self.seed)
        self.claims.release()
        check_stopped()
        return self.objective(trial)

    def _was_given_away(self) -> bool:
        if self.current is None:
            return False
        trial = self.study.get_trials(deepcopy=False)[self.current]
        return trial.state == TrialState.FAIL and "reason" not in trial.user_attrs

    def _queue_again(self) -> None:
        """Queue the trial that was interrupted: it says nothing of its network."""
        trials = self.study.get_trials()
        if self.current is None or self.current in retried_numbers(trials):
            return
        last = trials[self.current]
        if last.state == TrialState.FAIL and last.user_attrs.get("worker") == self.name:
            retry(self.study, last)

    def _check(self, last: FrozenTrial) -> None:
        self.failures = self.failures + 1 if last.state == TrialState.FAIL else 0
        why = str(last.user_attrs.get("reason"))
        if last.state == TrialState.FAIL and "CUDA error" in why:
            raise ResourceError(f"trial {last.number} broke the device's context ({why}); give the same command again")
        if self.failures >= MAX_FAILURES:
            raise InputError(
                f"{self.failures} trials in a row failed, the last with {why}; mend it and give the same command again"
            )


def _is_one_left(counts: Counts, n_trials: int) -> bool:
    return counts.finished + counts.running < n_trials
