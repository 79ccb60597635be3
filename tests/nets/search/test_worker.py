"""One worker's loop, whatever its trials do."""

import math
import time

import optuna
import pytest
import torch
from optuna.trial import TrialState

from nets.search.report import best_trial, trial_rows
from nets.search.signals import StoppedError
from nets.search.study import count, open_study
from nets.search.worker import MAX_FAILURES
from warp_caustics.errors import InputError, ResourceError


class Scripted:
    """Answers of trial after trial; exceptions are raised."""

    def __init__(self, *answers):
        self.answers = list(answers)

    def __call__(self, trial):
        trial.suggest_float("x", 0, 1)
        answer = self.answers.pop(0)
        if isinstance(answer, BaseException):
            raise answer
        return answer


def test_what_is_no_number_is_never_best(work):
    answers = (3.0, math.nan, math.inf, -math.inf, "many", RuntimeError("cuBLAS\nsays no"), MemoryError(), 2.0)
    memory = (torch.OutOfMemoryError("CUDA out of memory"), RuntimeError("Failed to allocate 9 bytes"))
    study = work(Scripted(*answers, *memory), 10)
    states = [trial.state.name for trial in study.trials]
    assert states == ["COMPLETE", *["PRUNED"] * 3, *["FAIL"] * 2, "PRUNED", "COMPLETE", "PRUNED", "PRUNED"]
    reasons = [trial.user_attrs.get("reason") for trial in study.trials]
    assert reasons[1:4] == ["objective is nan", "objective is inf", "objective is -inf"]
    assert reasons[4].startswith("ValueError") and reasons[5] == "RuntimeError: cuBLAS says no"
    assert reasons[6] == reasons[8] == reasons[9] == "out of memory"
    assert study.best_value == best_trial(study.trials).value == 2.0


def test_the_same_command_goes_on_up_to_the_total(work):
    study = work(Scripted(1.0, 2.0), 2, seed=1)
    assert work(Scripted(), 2) and len(study.trials) == 2
    study = work(Scripted(0.5, 3.0, RuntimeError()), 5, name="next", seed=2)
    assert [trial.number for trial in study.trials] == [0, 1, 2, 3, 4]
    assert [trial.user_attrs["worker"] for trial in study.trials] == ["me", "me", "next", "next", "next"]
    assert [trial.user_attrs["sampler_seed"] for trial in study.trials] == [1, 1, 2, 2, 2]
    assert len({trial.params["x"] for trial in study.trials}) == 5


@pytest.mark.parametrize("stop", [KeyboardInterrupt(), StoppedError("terminated")])
def test_an_interrupted_trial_is_failed_and_queued_again(work, where, tiny_search, stop):
    with pytest.raises(KeyboardInterrupt):
        work(Scripted(1.0, stop), 9)
    study = open_study(where, tiny_search())
    assert [trial.state.name for trial in study.trials] == ["COMPLETE", "FAIL", "WAITING"]
    assert study.trials[1].user_attrs["reason"] == (str(stop) or "interrupted")
    study = work(Scripted(2.0), 2)
    assert study.trials[2].value == 2.0 and study.trials[2].params == study.trials[1].params
    rows = trial_rows(study.trials, tiny_search())
    assert rows[1]["state"] == "fail, retried" and rows[2]["retry_of"] == 1


def test_an_interrupt_between_trials_queues_nothing(work, where, tiny_search, tmp_path, monkeypatch):
    monkeypatch.setattr("nets.search.worker.free_memory", lambda: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        work(Scripted(1.0), 9)
    assert [trial.state.name for trial in open_study(where, tiny_search()).trials] == ["COMPLETE"]


def test_failure_after_failure_ends_the_worker(work, where, tiny_search):
    answers = [RuntimeError("no"), 1.0, *[ValueError("the disk is gone")] * MAX_FAILURES]
    with pytest.raises(InputError, match="5 trials in a row failed, the last with ValueError: the disk is gone"):
        work(Scripted(*answers), 99)
    assert count(open_study(where, tiny_search())).failed == 1 + MAX_FAILURES


def test_a_broken_device_ends_the_process(work):
    with pytest.raises(ResourceError, match="trial 1 broke the device's context"):
        work(Scripted(1.0, RuntimeError("CUDA error: an illegal memory access")), 9)


def test_no_trial_begins_after_the_deadline(work):
    assert work(Scripted(), 9, deadline=time.monotonic()).trials == []


def test_a_trial_that_was_given_away_while_the_machine_slept(work, where, tiny_search):
    def slept(trial):
        trial.suggest_float("x", 0, 1)
        if trial.number == 0:
            open_study(where, tiny_search()).tell(0, state=TrialState.FAIL)
        return 1.0

    study = work(slept, 3)
    assert [trial.state.name for trial in study.trials] == ["FAIL", "COMPLETE", "COMPLETE"]


def test_a_pruned_trial_is_never_best(work):
    def objective(trial):
        trial.suggest_float("x", 0, 1)
        trial.report(0.1 if trial.number == 0 else 1.0, 1)
        if trial.number == 0:
            raise optuna.TrialPruned("enough")
        return 1.0

    assert best_trial(work(objective, 2).trials).number == 1
