"""What commands say, and where."""

import io
import json
import sys

from cli.console import Console, about
from warp_caustics.reconstruct.base import Progress


def states(count, step_s):
    return [Progress("level 1", i, count, 1 / i, i * step_s) for i in range(1, count + 1)]


def run(console, all_states):
    with console.progress() as show:
        for state in all_states:
            show(state)


def test_log_lines_come_now_and_then(capsys):
    run(Console(), states(100, step_s=0.5))
    captured = capsys.readouterr()
    assert captured.out == ""
    lines = captured.err.splitlines()
    assert len(lines) == 6  # at 0.5, 10.5, 20.5, ... s, and the estimate
    assert lines[1] == "estimate   level 1: at most about 50 s on this machine"
    assert lines[2] == "[   10.5 s] level 1: 21 of 100, residual 0.0476, 2/s, at most 0:00:40 left"


def test_short_stages_get_no_estimate(capsys):
    """Nor does one whose first iterations have not told yet how long they take."""
    run(Console(), states(18, step_s=0.5))
    run(Console(), states(2, step_s=30.0))
    assert "estimate" not in capsys.readouterr().err


def test_each_stage_is_announced(capsys):
    run(Console(), [Progress(f"level {i}", i, 3, 0.1, 0.0) for i in (1, 2, 3)])
    assert [line.split(": ")[0][-7:] for line in capsys.readouterr().err.splitlines()] == [
        "level 1",
        "level 2",
        "level 3",
    ]


def test_a_residual_that_is_not_known_is_not_shown(capsys):
    run(Console(), [Progress("network", 1, 2, float("nan"), 0.5)])
    assert capsys.readouterr().err.splitlines() == ["[    0.5 s] network: 1 of 2"]


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_a_terminal_gets_a_bar(monkeypatch):
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    run(Console(), states(3, step_s=0.1))
    assert "level 1" in terminal.getvalue() and "3/3" in terminal.getvalue()


def test_json_is_silent_but_for_the_record_and_warnings(capsys, monkeypatch):
    console = Console(as_json=True)
    run(console, states(3, step_s=20.0))
    console.line("for people")
    console.warn("careful")
    console.record({"a": 1})
    captured = capsys.readouterr()
    assert json.loads(captured.out) == {"a": 1}
    assert captured.err == "warning: careful\n"


def test_without_json_no_record_is_printed(capsys):
    Console().record({"a": 1})
    assert capsys.readouterr().out == ""


def test_lines_tell_rate_and_time_left(capsys):
    run(Console(), states(60, step_s=1.0))
    lines = [line for line in capsys.readouterr().err.splitlines() if not line.startswith("estimate")]
    assert lines[1].endswith("11 of 60, residual 0.0909, 1/s, at most 0:00:49 left")


def test_times_in_words():
    assert [about(s) for s in (0.2, 89, 180, 7200, 1e6)] == [
        "about 1 s", "about 89 s", "about 3 min", "about 2 h", "about 12 days",
    ]  # fmt: skip
