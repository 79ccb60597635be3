"""Folders of trainings: one writer at a time, and --force removes what a run wrote only."""

import os
import subprocess
import sys

import pytest
from attack import put, tree

from cli.main import main
from cli.marker import MARKER
from warp_caustics.errors import InputError, MismatchError


def test_two_trainings_into_one_folder(tmp_path):
    from cli.run_folder import run_folder

    run = tmp_path / "run"
    with run_folder(run, force=False, resume=False):
        for options in ({"force": True, "resume": False}, {"force": False, "resume": True}):
            with pytest.raises(MismatchError, match="is being written by process"), run_folder(run, **options):
                pass
    with run_folder(run, force=False, resume=False):
        pass


def test_a_dead_training_blocks_nobody(tmp_path):
    run = tmp_path / "run"
    program = (
        "import sys, time; from pathlib import Path; from cli.run_folder import run_folder\n"
        "with run_folder(Path(sys.argv[1]), force=False, resume=False):\n    print('in', flush=True); time.sleep(60)"
    )
    process = subprocess.Popen([sys.executable, "-c", program, str(run)], stdout=subprocess.PIPE)
    assert process.stdout.readline() == b"in\n"
    from cli.run_folder import run_folder

    with pytest.raises(MismatchError, match=f"process {process.pid}"), run_folder(run, force=True, resume=False):
        pass
    process.kill()
    process.wait()
    with run_folder(run, force=False, resume=True):
        pass
    assert (run / ".lock").read_bytes() == b""


def test_force_of_a_run_removes_what_a_run_wrote(tmp_path):
    from cli.run_folder import run_folder

    run = tmp_path / "run"
    with run_folder(run, force=False, resume=False):
        for name in ("checkpoints/last.ckpt", "pictures/step-00000001.png", "tensorboard/events.out.tfevents.1.h.2.3"):
            (run / name).parent.mkdir(exist_ok=True)
            (run / name).touch()
    for name in ("checkpoints/model.pt", "pictures/holiday.png", "tensorboard/run/x", "metrics.xlsx"):
        path = put(run / name, "file", tmp_path)
        before = tree(run)
        with pytest.raises(InputError, match="holds other files"), run_folder(run, force=True, resume=False):
            pass
        assert tree(run) == before
        path.unlink()
        if name == "tensorboard/run/x":
            path.parent.rmdir()
    with run_folder(run, force=True, resume=False):
        assert sorted(os.listdir(run)) == [".lock", MARKER]


def test_a_run_of_an_earlier_version_may_be_resumed_and_replaced(tmp_path):
    from cli.run_folder import run_folder

    run = tmp_path / "run"
    (run / "checkpoints").mkdir(parents=True)
    (run / "checkpoints" / "last.ckpt").touch()
    (run / "config.resolved.yaml").write_text("kind: direct\nnetwork: {}\nscene: {}\ntraining: {}\n")
    with run_folder(run, force=False, resume=True):
        pass
    (run / MARKER).unlink()
    with run_folder(run, force=True, resume=False):
        assert not (run / "checkpoints").exists()


def test_a_training_that_cannot_start_deletes_nothing(tmp_path, capsys):
    from cli.run_folder import run_folder

    run = tmp_path / "run"
    with run_folder(run, force=False, resume=False):
        (run / "weights.safetensors").write_text("weights")
    for options in (
        ["--device", "cuda:99"],
        ["--device", "cpu", "--initial-weights", str(tmp_path / "none")],
        ["--device", "cpu", "--initial-weights", str(run / "weights.safetensors")],
    ):
        assert main(["train", "direct", "--fresh", "-o", str(run), "--force", "--max-steps", "1", *options]) in (3, 6)
        assert (run / "weights.safetensors").read_text() == "weights"
