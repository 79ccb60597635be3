"""P15: early stopping stops when it says."""

import math

import pytest

from nets.training.config import default_run
from nets.training.state import EarlyStopping

NAN, INF = math.nan, math.inf
TABLE = {
    "improving": ([9, 8, 7, 6, 5, 4, 3, 2], None, 8),
    "flat from the start": ([5, 5, 5, 5, 5, 5, 5], 5, 1),
    "no stop before five epochs": ([1, 2, 3, 4, 5, 6], 5, 1),
    "bouncing": ([5, 6, 4, 6, 3, 6, 2, 6, 1, 6], None, 9),
    "stops three after the best": ([5, 4, 3, 2, 1, 2, 2, 2, 0], 8, 5),
    "progress in the last allowed epoch": ([5, 4, 3, 2, 1, 2, 2, 0.5, 2, 2, 2], 11, 8),
    "nan is no progress": ([5, NAN, NAN, NAN, NAN], 5, 1),
    "nan first": ([NAN, NAN, 3, 2, 1, 1, 1, 1], 8, 5),
    "only nan": ([NAN] * 6, 5, 0),
    "infinity is no progress": ([INF, INF, INF, INF, INF], 5, 0),
    "minus infinity is no progress": ([5, -INF, -INF, -INF, -INF], 5, 1),
    "ties keep the first": ([5, 4, 3, 2, 2, 2, 2], 7, 4),
}


def run(losses, patience=3):
    """Epoch at which it stops (None: never) and the best one."""
    stopping = EarlyStopping(patience, 5)
    for loss in losses:
        stopping.saw(loss)
        if stopping.should_stop:
            return stopping.epoch, stopping.best_epoch
    return None, stopping.best_epoch


@pytest.mark.parametrize("name", TABLE)
def test_table(name):
    losses, stop, best = TABLE[name]
    assert run(losses) == (stop, best)


def test_without_patience_it_never_stops():
    assert run([1.0] * 50, patience=None) == (None, 1)


@pytest.mark.parametrize("interruption", range(9))
@pytest.mark.parametrize("name", TABLE)
def test_a_restored_one_stops_at_the_same_epoch(name, interruption):
    losses, stop, best = TABLE[name]
    stopping = EarlyStopping(3, 5)
    for epoch, loss in enumerate(losses):
        if epoch == interruption:
            state = stopping.state()
            stopping = EarlyStopping(3, 5)
            stopping.restore(state)
        stopping.saw(loss)
        if stopping.should_stop:
            break
    assert (stopping.epoch if stopping.should_stop else None, stopping.best_epoch) == (stop, best)


def test_forgetting_the_waiting_is_caught():
    losses, stop, _ = TABLE["stops three after the best"]
    stopping = EarlyStopping(3, 5)
    for epoch, loss in enumerate(losses):
        if epoch == 6:
            stopping.restore({**stopping.state(), "waited": 0})
        stopping.saw(loss)
        if stopping.should_stop:
            break
    assert stopping.epoch != stop


@pytest.mark.parametrize("kind", ["denoiser", "updater"])
def test_the_papers_networks_stop_as_the_paper_says(kind):
    """Section 2.1: after three epochs without progress; five epochs are the least."""
    training = default_run(kind)["training"]

    def stopped_after(losses):
        stopping = EarlyStopping(training["patience"], training["min_epochs"])
        for loss in losses:
            stopping.saw(loss)
            if stopping.should_stop:
                return stopping.epoch
        return None

    assert stopped_after([1.0] * 40) == 5
    assert stopped_after([9.0, 8.0, 7.0, 6.0, 5.0, 4.0] + [4.0] * 40) == 6 + 3
