"""One trial: train the network that was proposed, and answer with its best validation loss."""

import gc
import math
import time
from collections.abc import Callable
from typing import Any

import optuna
import torch

from nets.architecture import parameter_count
from nets.search.config import SearchConfig, trial_run
from nets.search.signals import StoppedError, check_stopped
from nets.search.space import suggested
from nets.training.batch import Batch, Source, Told, silent
from nets.training.devices import launched
from nets.training.fit import fit
from nets.training.limits import FINAL_SECONDS, Limits
from nets.training.progress import DivergedError, TrainingProgress
from nets.training.sources import make_source
from warp_caustics.errors import InputError, is_out_of_memory

Objective = Callable[[optuna.Trial], float]
MakeObjective = Callable[[SearchConfig, str, float | None], Objective]
"""From search, device and the time (``time.monotonic()``) when all must end; can be sent to another process."""


class SharedSource:
    """A source that many trainings use one after another; only its owner closes it."""

    def __init__(self, inner: Source):
        self.inner, self.steps_per_epoch = inner, inner.steps_per_epoch
        self._validation: list[Batch] = []

    def batch(self, step: int) -> Batch:
        return self.inner.batch(step)

    def resume(self, step: int) -> None:
        self.inner.resume(step)

    def validation(self, told: Told = silent) -> list[Batch]:
        """Made once."""
        if not self._validation:
            self._validation = self.inner.validation()
        return self._validation

    def close(self) -> None:
        """Nothing: the next training goes on with it."""


class TrainingObjective:
    """Trains the networks of one worker's trials, all on the same samples.

    Args:
        search: what is searched.
        device: where.
        deadline: ``time.monotonic()`` at which trials are cut off; None for never.
    """

    def __init__(self, search: SearchConfig, device: str, deadline: float | None):
        self.search, self.deadline = search, deadline
        self.fabric: Any = launched(device, 1)
        training = search.run.training
        self.source = SharedSource(make_source(search.run, self.fabric.device))
        if training.fixed_samples:
            self.source.batch(0)  # the pool is filled now: no trial pays for it
        self.source.validation()
        self.steps_per_epoch = max(1, self.source.steps_per_epoch // training.accumulate)

    def __call__(self, trial: optuna.Trial) -> float:
        search, start = self.search, time.monotonic()
        config = trial_run(search, suggested(trial, search.kind), search.max_epochs * self.steps_per_epoch)
        try:
            trial.set_user_attr("parameters", parameter_count(config.network, config.scene))
        except InputError as error:
            raise optuna.TrialPruned(f"too large: {error}") from error
        ends = [self.deadline] if self.deadline is not None else []
        if search.trial_time_s is not None:
            ends.append(start + search.trial_time_s)
        limits = Limits(None, min(ends) + FINAL_SECONDS / 2 if ends else None)
        watcher = _EpochReporter(trial, search.max_epochs)
        try:
            result = fit(config, None, self.fabric, watcher, limits, resume=False, source=self.source)
        except DivergedError as error:
            raise optuna.TrialPruned(f"diverged: {error}") from error
        finally:
            # A decay that ends elsewhere would be another training.
            is_constant = config.training.schedule == "constant"
            steps = watcher.epoch * self.steps_per_epoch if is_constant else config.training.total_steps
            trial.set_user_attr("steps", steps)
        if result.stop_reason in ("interrupted", "terminated"):
            raise StoppedError(result.stop_reason)
        if result.stop_reason == "max_time":
            if self.deadline is not None and time.monotonic() >= self.deadline:
                raise optuna.TrialPruned("cut off by the end of the search's time")
            if result.best is None:
                raise optuna.TrialPruned(f"no epoch within {search.trial_time_s:g} s")
        trial.set_user_attr("stopped_by", result.stop_reason)
        return math.inf if result.best is None else result.best

    def close(self) -> None:
        """Release the samples and those who read them."""
        self.source.inner.close()


class _EpochReporter:
    """Tells Optuna the best loss so far after every epoch, and ends trainings that it prunes."""

    def __init__(self, trial: optuna.Trial, max_epochs: int):
        self.trial, self.max_epochs = trial, max_epochs
        self.epoch, self.best = 0, math.inf

    def show(self, progress: TrainingProgress) -> None:
        if not progress.is_validation:
            return
        check_stopped()
        self.epoch += 1
        loss = progress.validation["val_loss"]
        if not math.isfinite(loss):
            raise DivergedError(f"validation loss is {loss} after epoch {self.epoch}")
        self.best = min(self.best, loss)
        self.trial.report(self.best, self.epoch)
        if self.epoch < self.max_epochs and self.trial.should_prune():
            raise optuna.TrialPruned(f"not among the best after epoch {self.epoch}")

    def stage(self, what: str, done: int, total: int) -> None:
        pass

    def tick(self, step: int, share: float | None, left_s: float | None) -> None:
        pass

    def note(self, text: str) -> None:
        pass

    def warn(self, text: str) -> None:
        pass


def guarded(objective: Objective) -> Objective:
    """The objective with answers and errors that a study survives.

    What is no finite number is pruned, because Optuna would take -inf for the best
    of all. So is what does not fit into the memory. Other errors fail the trial.
    The reason is kept with the trial.
    """

    def call(trial: optuna.Trial) -> float:
        try:
            value = float(objective(trial))
            if not math.isfinite(value):
                raise optuna.TrialPruned(f"objective is {value}")
            return value
        except optuna.TrialPruned as error:
            trial.set_user_attr("reason", _line(str(error)))
            raise
        except KeyboardInterrupt as error:
            trial.set_user_attr("reason", str(error) or "interrupted")
            raise
        except Exception as error:
            if not is_out_of_memory(error):
                trial.set_user_attr("reason", _line(f"{type(error).__name__}: {error}"))
                raise
        # Outside of the handler, where the traceback still holds the tensors of the training.
        free_memory()
        trial.set_user_attr("reason", "out of memory")
        raise optuna.TrialPruned("out of memory")

    return call


def free_memory() -> None:
    """Give back what the last training held."""
    gc.collect()
    if torch.cuda.is_available():
        torch.cuda.empty_cache()


def _line(text: str) -> str:
    return " ".join(text.split())[:300]
