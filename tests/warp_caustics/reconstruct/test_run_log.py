"""The log of a run: history, progress, limits."""

import time

import pytest

from warp_caustics.reconstruct.objective import Evaluation
from warp_caustics.reconstruct.run_log import RunLog, StopRun, following, note_evaluation, why_stopped


def test_entries_and_progress():
    seen = []
    log = RunLog(2, seen.append)
    log.note("first", 0.5, loss=0.125)
    log.note("second", None)
    log.note("third", 0.25)
    assert [entry["iteration"] for entry in log.history] == [1, 2, 3]
    assert log.history[0]["loss"] == 0.125 and log.history[1]["residual"] is None
    assert [(state.stage, state.iteration, state.total) for state in seen] == [
        ("first", 1, 2),
        ("second", 2, 2),
        ("third", 3, 3),
    ]
    assert seen[1].residual != seen[1].residual
    assert 0 <= log.history[0]["elapsed_s"] <= log.history[2]["elapsed_s"] <= log.elapsed_s


def test_noise_is_named_before_time():
    """What was found at a limit is on record, and has been told."""
    log = RunLog(5, max_time_s=-1.0, discrepancy=1.0)
    with pytest.raises(StopRun) as stop:
        note_evaluation(log, "here", Evaluation(2.0, 0.1, 0.9))
    assert why_stopped(stop.value) == "discrepancy"
    assert log.history[0]["objective"] == 2.0 and log.history[0]["discrepancy"] == 0.9
    with pytest.raises(KeyboardInterrupt) as stop:
        log.note("here", 0.1, noise=1.1)
    assert why_stopped(stop.value) == "max_time"
    assert why_stopped(KeyboardInterrupt()) == "interrupted"
    RunLog(1).note("no limits", 0.0, noise=0.1)


def test_a_later_part_counts_on():
    seen = []
    progress = following(seen.append, 7, time.perf_counter() - 100, "refinement, ")
    RunLog(5, progress).note("64 pixels", 0.5)
    assert (seen[0].stage, seen[0].iteration, seen[0].total) == ("refinement, 64 pixels", 8, 12)
    assert seen[0].elapsed_s > 100
    assert following(None, 7, 0.0) is None
