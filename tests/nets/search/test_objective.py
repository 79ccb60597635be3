"""One trial: how each end of a training is judged."""

import math
import time

import optuna
import pytest

from nets.search import objective as objective_module
from nets.search.objective import SharedSource, TrainingObjective, guarded
from nets.search.signals import StoppedError
from nets.search.space import best_of_paper
from nets.training.progress import DivergedError, TrainingProgress, TrainingResult


class Source:
    steps_per_epoch = 3
    made = 0

    def batch(self, step):
        return {}

    def validation(self, told=None):
        self.made += 1
        return [{}]

    def close(self):
        self.made = -1


@pytest.fixture
def judged(monkeypatch, tiny_search):
    """Judges Tab. 2's best denoiser by a scripted training: losses of its epochs, then how it ended."""
    monkeypatch.setattr(objective_module, "make_source", lambda *arguments: Source())

    def call(losses, end="finished", *, deadline=None, **options):
        def scripted(config, folder, fabric, observer, limits, *, resume, source):
            assert folder is None and isinstance(source, SharedSource)
            assert config.training.total_steps == 9 * Source.steps_per_epoch
            for loss in losses:
                observer.show(TrainingProgress(0, None, 0.0, 0.0, 0.0, 0.0, 0.0, {"val_loss": loss}, True))
            if isinstance(end, Exception):
                raise end
            best = min(losses, default=None)
            return TrainingResult(end, 0, 0.0, best, "val_loss", {}, None)

        monkeypatch.setattr(objective_module, "fit", scripted)
        search = tiny_search(**options)
        study = optuna.create_study(pruner=options.pop("pruner", optuna.pruners.NopPruner()))
        study.enqueue_trial(best_of_paper("denoiser"))
        study.optimize(guarded(TrainingObjective(search, "cpu", deadline)), n_trials=1, catch=(Exception,))
        return study.trials[0]

    return call


def test_the_best_epoch_counts_and_each_is_reported(judged):
    trial = judged([3.0, 1.0, 2.0])
    assert trial.value == 1.0 and trial.intermediate_values == {1: 3.0, 2: 1.0, 3: 1.0}
    assert trial.user_attrs["steps"] == 9 and trial.user_attrs["parameters"] > 1e6
    assert judged([3.0, 1.0], schedule="cosine").user_attrs["steps"] == 27


@pytest.mark.parametrize(
    ("losses", "end", "options", "reason"),
    [
        ([1.0, math.nan], "finished", {}, "diverged: validation loss is nan after epoch 2"),
        ([math.inf], "finished", {}, "diverged: validation loss is inf after epoch 1"),
        ([1.0], DivergedError("loss is nan at step 3"), {}, "diverged: loss is nan at step 3"),
        ([], "max_time", {"trial_time_s": 2.0}, "no epoch within 2 s"),
        ([1.0], "max_time", {"deadline": 0.0}, "cut off by the end of the search's time"),
        ([], RuntimeError("CUDA out of memory. Tried to allocate"), {}, "out of memory"),
    ],
)
def test_what_is_pruned_and_why(judged, losses, end, options, reason):
    trial = judged(losses, end, **options)
    assert (trial.state.name, trial.user_attrs["reason"]) == ("PRUNED", reason)


def test_a_trial_that_used_its_time_is_judged_by_what_it_reached(judged):
    trial = judged([2.0, 1.5], "max_time", trial_time_s=2.0, deadline=time.monotonic() + 100)
    assert (trial.state.name, trial.value, trial.user_attrs["stopped_by"]) == ("COMPLETE", 1.5, "max_time")


def test_a_signal_ends_the_search(judged):
    with pytest.raises(StoppedError, match="terminated"):
        judged([1.0], "terminated")


def test_a_network_that_is_too_large_is_not_built(judged, monkeypatch):
    monkeypatch.setattr("nets.architecture.MAX_PARAMETERS", 10)
    trial = judged([1.0])
    assert trial.state.name == "PRUNED" and trial.user_attrs["reason"].startswith("too large: network would have")


def test_a_shared_source_is_validated_once_and_stays_open():
    inner = Source()
    shared = SharedSource(inner)
    assert shared.validation() is shared.validation() and inner.made == 1
    shared.close()
    assert inner.made == 1
