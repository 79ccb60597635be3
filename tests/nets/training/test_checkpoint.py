"""Checkpoints: whole or absent, damage is noticed, nothing in them runs."""

import hashlib
import io
import os
import pickle
import signal
import subprocess
import sys
import time

import pytest
import torch

from nets.training.checkpoint import load_checkpoint, newest_checkpoint, save_checkpoint
from warp_caustics.errors import DamagedDataError, InputError


def state(step):
    return {"step": step, "weights": torch.full((100,), float(step)), "nested": {"values": [1.5, None, "x"]}}


def test_round_trip(tmp_path):
    save_checkpoint(tmp_path, state(1))
    found = load_checkpoint(tmp_path / "last.ckpt")
    assert torch.equal(found.pop("weights"), state(1)["weights"])
    assert found == {"step": 1, "nested": {"values": [1.5, None, "x"]}}


def test_the_one_before_is_kept(tmp_path):
    for step in (1, 2, 3):
        save_checkpoint(tmp_path, state(step))
    assert [load_checkpoint(tmp_path / f"{n}.ckpt")["step"] for n in ("last", "previous")] == [3, 2]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["last.ckpt", "previous.ckpt"]


def test_every_flipped_byte_is_noticed(tmp_path):
    save_checkpoint(tmp_path, state(1))
    path = tmp_path / "last.ckpt"
    content = path.read_bytes()
    for position in range(0, len(content), max(1, len(content) // 150)):
        path.write_bytes(content[:position] + bytes([content[position] ^ 4]) + content[position + 1 :])
        with pytest.raises(DamagedDataError, match="damaged"):
            load_checkpoint(path)
    for length in (1, 31, 32, 33, len(content) // 2, len(content) - 1):
        path.write_bytes(content[:length])
        with pytest.raises(DamagedDataError):
            load_checkpoint(path)


def test_a_damaged_last_one_falls_back_to_the_one_before(tmp_path):
    save_checkpoint(tmp_path, state(1))
    save_checkpoint(tmp_path, state(2))
    assert newest_checkpoint(tmp_path)[1] is None
    (tmp_path / "last.ckpt").write_bytes(b"x" * 1000)
    found, warning = newest_checkpoint(tmp_path)
    assert found["step"] == 1 and "last.ckpt" in warning and "continuing from previous.ckpt" in warning
    (tmp_path / "previous.ckpt").write_bytes(b"")
    with pytest.raises(InputError, match=r"empty"):
        newest_checkpoint(tmp_path)
    (tmp_path / "previous.ckpt").write_bytes(b"x" * 1000)
    with pytest.raises(DamagedDataError, match="no checkpoint"):
        newest_checkpoint(tmp_path)


def test_no_checkpoint(tmp_path):
    with pytest.raises(InputError, match="no checkpoint to resume from"):
        newest_checkpoint(tmp_path)


class Hostile:
    def __init__(self, canary):
        self.canary = canary

    def __reduce__(self):
        return os.mkdir, (str(self.canary),)


@pytest.mark.filterwarnings("ignore:Detected pickle protocol")
@pytest.mark.parametrize("form", ["zip", "pickle"])
def test_a_hostile_one_runs_nothing(tmp_path, monkeypatch, form):
    """Also where the environment turns torch's default to unsafe."""
    monkeypatch.setenv("TORCH_FORCE_NO_WEIGHTS_ONLY_LOAD", "1")
    canary, buffer = tmp_path / "canary", io.BytesIO()
    if form == "zip":
        torch.save({"step": Hostile(canary)}, buffer)
    else:
        buffer.write(pickle.dumps({"step": Hostile(canary)}))
    content = buffer.getvalue()
    (tmp_path / "last.ckpt").write_bytes(content + hashlib.sha256(content).digest())
    with pytest.raises(DamagedDataError, match="cannot be read"):
        load_checkpoint(tmp_path / "last.ckpt")
    assert not canary.exists()
    pickle.loads(pickle.dumps(Hostile(canary)))
    assert canary.exists(), "control: it would have run"


def test_kill_9_loses_at_most_one_interval(tmp_path):
    """Killed at many moments; what can be loaded is never older than what was acknowledged."""
    program = (
        "import sys, torch\n"
        "from pathlib import Path\n"
        "from nets.training.checkpoint import save_checkpoint\n"
        "step = int(sys.argv[2])\n"
        "while True:\n"
        "    step += 1\n"
        "    save_checkpoint(Path(sys.argv[1]), {'step': step, 'weights': torch.full((200000,), float(step))})\n"
        "    print(step, flush=True)\n"
    )
    acknowledged = 0
    for delay_s in (0.003, 0.05, 0.11):
        process = subprocess.Popen(
            [sys.executable, "-c", program, str(tmp_path), str(acknowledged)], stdout=subprocess.PIPE, text=True
        )
        process.stdout.readline()  # it has begun to save
        time.sleep(delay_s)
        process.send_signal(signal.SIGKILL)
        lines = process.stdout.read().split()
        process.wait()
        acknowledged = max([acknowledged + 1, *map(int, lines)])
        found, warning = newest_checkpoint(tmp_path)
        assert warning is None
        assert acknowledged <= found["step"] <= acknowledged + 1
        assert torch.equal(found["weights"], torch.full((200000,), float(found["step"])))
        acknowledged = found["step"]
