"""Signals wait for a moment that suits."""

import os
import signal

import pytest

from nets.search.signals import StoppedError, check_stopped, signals_wait
from nets.search.study import open_study


@pytest.mark.parametrize(("number", "reason"), [(signal.SIGINT, "interrupted"), (signal.SIGTERM, "terminated")])
def test_a_signal_waits_and_a_second_one_does_not(number, reason):
    before = signal.getsignal(number)
    with signals_wait():
        check_stopped()
        os.kill(os.getpid(), number)
        with pytest.raises(StoppedError, match=reason):
            check_stopped()
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), number)
    assert signal.getsignal(number) == before
    check_stopped()  # forgotten


def test_a_signal_between_the_steps_of_a_trial_ends_the_search_in_order(work, where, tiny_search):
    """As sent while the database is written: the trial is failed and queued again, nothing stays locked."""

    def objective(trial):
        os.kill(os.getpid(), signal.SIGINT)
        trial.suggest_float("x", 0, 1)
        check_stopped()

    with pytest.raises(StoppedError, match="interrupted"):
        work(objective, 9)
    assert [trial.state.name for trial in open_study(where, tiny_search()).trials] == ["FAIL", "WAITING"]
