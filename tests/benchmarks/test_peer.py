"""Beside Dr.Jit: who cannot have it is told in one line; calls take turns."""

import sys

import numpy as np
import pytest

from benchmarks import peer


def test_without_the_wheel_one_line_says_so(tmp_path, monkeypatch, capsys):
    def refusing(folder, **_):
        python = folder / "bin" / "python"
        python.parent.mkdir(parents=True)
        python.write_text("#!/bin/sh\nprintf 'much\\nERROR: No matching distribution found\\n\\n' >&2\nexit 1\n")
        python.chmod(0o755)

    monkeypatch.setattr(peer, "ENVIRONMENT", tmp_path / "peer")
    monkeypatch.setattr(peer.venv, "create", refusing)
    monkeypatch.setattr(sys, "argv", ["peer"])
    with pytest.raises(SystemExit) as end:
        peer.main()
    assert end.value.code == 0
    assert (
        capsys.readouterr().out == f"skipped: pip cannot install {peer.WHEEL}: ERROR: No matching distribution found\n"
    )
    assert not (tmp_path / "peer" / "made").exists()


def test_a_tracer_that_dies_is_no_peer(tmp_path, monkeypatch):
    """As without LLVM's library: its last words are passed on."""
    tracer = tmp_path / "tracer.py"
    tracer.write_text("raise RuntimeError('no LLVM here')")
    monkeypatch.setattr(peer, "python_of_peer", lambda: sys.executable)
    monkeypatch.setattr(peer, "TRACER", tracer)
    with pytest.raises(peer.NoPeer, match="no LLVM here"):
        peer.Peer({}, "cpu")


def test_calls_take_turns():
    """Two rounds are warm-up; medians of the others."""
    order, clock = [], iter(range(100))

    def call(name):
        order.append(name)
        return float(next(clock))

    rows = [
        {"calls": {"forward": lambda: call("a"), "both": lambda: call("b")}},
        {"calls": {"forward": lambda: call("c")}},
    ]
    peer.in_turns(rows, 3)
    assert order == ["a", "b", "c"] * 5
    assert rows[0] == {"forward": {"median_ms": 9.0, "low_ms": 6.0}, "both": {"median_ms": 10.0, "low_ms": 7.0}}


def test_the_task_is_the_scene(tmp_path):
    task = peer.task_of(tmp_path)
    assert task["pixels"] == 512 and len(task["glass"]) == task["channels"] == 3
    assert task["window_m"][0] == pytest.approx(-task["plate_m"] / 2)
    assert np.load(task["coefficients"]).shape == (task["samples"] + 4,) * 2
