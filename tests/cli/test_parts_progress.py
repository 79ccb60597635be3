"""Progress of work in parts: rate and time left, none within the first seconds."""

import io
import sys

import pytest

from cli import parts_progress as module
from cli.cells import remaining_s
from cli.console import Console
from cli.parts_progress import PartsPace, parts_progress


class Clock:
    now_s = 50.0

    def monotonic(self):
        return self.now_s


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(module, "time", clock)
    return clock


def test_rate_and_time_left(clock):
    pace = PartsPace(done=3)
    clock.now_s += 20
    assert pace(3, 10) == "", "nothing was done yet"
    assert pace(5, 10) == "6/min, about 50 s left"
    assert pace(103, 203) == "5/s, about 20 s left"
    assert pace(10, 10) == "21/min"


def test_what_is_quick_needs_none(clock):
    pace = PartsPace()
    clock.now_s += 4
    assert pace(5, 10) == ""


def test_lines_come_now_and_then(clock, capsys):
    with parts_progress(Console(), "fields") as told:
        for done in range(31):
            told(done, 30)
            clock.now_s += 2
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "fields: 3 of 30, 30/min, about 54 s left" and len(lines) == 6
    with parts_progress(Console(as_json=True), "fields") as told:
        clock.now_s += 20
        told(1, 2)
    assert capsys.readouterr().err == ""


def test_a_terminal_gets_a_bar(monkeypatch):
    terminal = io.StringIO()
    terminal.isatty = lambda: True
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    with parts_progress(Console(), "fields") as told:
        told(2, 3)
    assert "fields" in terminal.getvalue() and "2/3" in terminal.getvalue()


def test_cells_count_with_the_mean_of_their_own_method():
    """One of 100 s and one of 1 s, ten fields each; all else (scores, images) is in the same proportion."""
    slow, fast = ("nsfc", "10"), ("direct", "converged")
    times_s = {slow: [90.0, 110.0], fast: [1.0]}
    assert remaining_s({slow: 3, fast: 5}, times_s, 402.0) == pytest.approx(2 * (3 * 100 + 5))
    assert remaining_s({slow: 3, fast: 5}, times_s, 100.5) == pytest.approx((3 * 100 + 5) / 2), "two processes"
    assert remaining_s({slow: 3, ("sfc", "1"): 1}, times_s, 402.0) is None, "nobody knows how long sfc takes"
    assert remaining_s({slow: 3}, times_s, 2.0) is None and remaining_s({slow: 0}, times_s, 402.0) is None


def test_a_search_tells_trials_done_and_the_time_left(clock, capsys):
    """Those of an earlier call do not count as fast."""
    optuna = pytest.importorskip("optuna")
    from cli.search_progress import search_progress

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    study = optuna.create_study()
    study.add_trial(optuna.trial.create_trial(value=2.0))
    with search_progress(Console(), study, 5) as show:
        clock.now_s += 30
        show(study)
        assert capsys.readouterr().err == ""
        study.add_trial(optuna.trial.create_trial(value=1.0))
        show(study)
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("trial 1: loss 1 (best)") and line.endswith("; 2 of 5 trials, 2/min, about 2 min left")
