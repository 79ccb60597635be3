"""``nsfc search``."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml

from cli.main import main
from cli.train_config import new_run
from nets.search.study import address, open_study
from tests.memory_folder import memory_folder

TINY = [
    "--device", "cpu", "--precision", "32", "--batch-size", "2", "--pool", "4", "--steps-per-epoch", "2",
    "--max-epochs", "5",
    *(f"--set={setting}" for setting in (
        "scene.height_samples=16", "scene.image_pixels=64", "training.validation.count=2",
        "training.noisy.n_photons=1000", "training.clean.n_photons=16000", "training.log_every_steps=2",
    )),
]  # fmt: skip


def search(*arguments):
    return main(["search", *map(str, arguments)])


def refused(capsys, *arguments):
    """Exit code and message; one line and nothing on stdout."""
    code = search(*arguments)
    captured = capsys.readouterr()
    assert captured.out == "" and captured.err.count("\n") == 1, captured.err
    return code, captured.err


@pytest.fixture
def tmp_path(tmp_path):
    """SQLite waits for the disk some hundred times in a small search."""
    with memory_folder(tmp_path) as folder:
        yield folder


@pytest.fixture
def small_members(monkeypatch):
    """Draws that do not depend on this machine; what has more than 1e5 parameters is too large."""
    monkeypatch.setattr("nets.search.processes.socket.gethostname", lambda: "host")
    monkeypatch.setattr("nets.architecture.MAX_PARAMETERS", 100_000)


def test_a_search_its_continuation_and_its_winner(tmp_path, capsys, small_members):
    """Two of the three trials are small enough; best.yaml, trained by nsfc train, gives the logged loss again."""
    folder = tmp_path / "found"
    start = ("denoiser", "--fresh", "-o", folder, *TINY, "--seed", 24)
    assert search(*start, "--n-trials", 2) == 0
    captured = capsys.readouterr()
    assert "2 trials: 2 complete, 0 pruned, 0 failed" in captured.out
    lines = captured.err.splitlines()
    assert len(lines) == 2 and lines[0].startswith("trial 0: loss ") and "5 epochs" in lines[0]
    assert "360 parameters" in lines[0]
    assert search(*start, "--n-trials", 3, "--json") == 0
    captured = capsys.readouterr()
    record = json.loads(captured.out)
    assert record["trials"]["finished"] == 3 and record["trials"]["complete"] >= 2
    files = {"best.yaml", "network.yaml", "report.html", "search.yaml", "study.db", "trials.csv"}
    assert {path.name for path in folder.iterdir() if not path.name.startswith(".")} == files
    train = ["train", "denoiser", "--fresh", "--device", "cpu", "-o"]
    assert main([*train, str(tmp_path / "run"), "--config", str(folder / "best.yaml"), "--json"]) == 0
    again = json.loads(capsys.readouterr().out)
    assert again["best"] == pytest.approx(record["best"]["loss"], rel=1e-6)
    assert again["config"]["network"]["network"]["c_init"] == record["best"]["values"]["c_init"]
    for name in ("best.yaml", "network.yaml"):
        found = new_run("denoiser", None, str(folder / name), ["training.fixed_samples=0"], {})
        assert found.network.network.model_dump(exclude_none=True) == record["best"]["values"]
        assert found.training.learning_rate == record["best"]["values"]["learning_rate"]
        assert found.scene.image_pixels == (64 if name == "best.yaml" else 512)
    # The same folder with another scene is another search; nothing in it is touched.
    before = {path.name: path.read_bytes() for path in folder.iterdir() if path.suffix != ".db"}
    code, message = refused(capsys, *start, "--n-trials", 9, "--set", "scene.image_pixels=32")
    assert code == 5 and "scene.image_pixels 64 there, 32 here" in message
    code, message = refused(capsys, "updater", *start[1:], "--n-trials", 9, "--study", "nsfc-denoiser")
    assert code == 5 and "kind 'denoiser' there, 'updater' here" in message
    assert {path.name: path.read_bytes() for path in folder.iterdir() if path.suffix != ".db"} == before


def test_members_that_are_too_large_are_pruned_and_the_updater_is_searched(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("nets.architecture.MAX_PARAMETERS", 1)
    assert search("updater", "--fresh", "-o", tmp_path / "s", *TINY, "--n-trials", 3, "--paper-first") == 0
    captured = capsys.readouterr()
    assert "3 trials: 0 complete, 3 pruned" in captured.out and "none, no trial is complete" in captured.out
    assert captured.err.count("pruned, too large: network would have") == 3
    study = open_study(address(None, tmp_path / "s", "nsfc-updater"), _stored(tmp_path / "s"))
    assert study.trials[0].params["lambda_tv"] == 9.81e-10 and study.trials[0].user_attrs["origin"] == "Tab. 2"


def _stored(folder):
    from nets.search.config import SearchConfig

    return SearchConfig.model_validate(yaml.safe_load((folder / "search.yaml").read_text()))


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["denoiser"], 2, "give the folder of a data set or --fresh, and not both"),
        (["denoiser", "data", "--fresh"], 2, "and not both"),
        (["direct", "--fresh"], 2, "'direct' is not one of"),
        (["denoiser", "data", "--steps-per-epoch", "3"], 2, "a data set has epochs of its own"),
        (["denoiser", "--fresh", "--workers", "0"], 2, "--workers 0 is below 1"),
        (["denoiser", "--fresh", "--max-epochs", "4"], 3, "--max-epochs"),
        (["denoiser", "--fresh", "--pool", "1"], 3, "smaller than a batch"),
        (["denoiser", "--fresh", "--set", "network.network.k_down=3"], 3, "is what the search varies; leave it out"),
        (["denoiser", "--fresh", "--set", "training.learning_rate=1"], 3, "is what the search varies"),
        (["denoiser", "--fresh", "--storage", "journal://x"], 3, "storage of kind 'journal' is not supported"),
        (["denoiser", "--fresh", "--devices", "2", "--device", "cpu"], 3, "--device cpu is one"),
        (["denoiser", "missing"], 3, "missing"),
        (["denoiser", "--fresh", "--device", "cuda:99"], 6, "--device cpu"),
    ],
)
def test_refusals(tmp_path, capsys, monkeypatch, arguments, code, message):
    monkeypatch.chdir(tmp_path)
    found, text = refused(capsys, *arguments, "-o", tmp_path / "s", "--n-trials", 1)
    assert (found, message in text) == (code, True), text


def test_a_folder_of_something_else_is_left_alone(tmp_path, capsys):
    (tmp_path / "thesis.txt").write_text("mine")
    code, message = refused(capsys, "denoiser", "--fresh", "-o", tmp_path, "--n-trials", 1, *TINY)
    assert code == 3 and "holds other files (thesis.txt)" in message
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]


@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), pytest.param(signal.SIGTERM, 143, marks=pytest.mark.slow)]
)
def test_a_stopped_search_says_how_to_go_on(tmp_path, number, code):
    folder = tmp_path / "s"
    nsfc = Path(sys.executable).with_name("nsfc")
    arguments = ["search", "denoiser", "--fresh", "-o", folder, *TINY, "--n-trials", "99", "--seed", "24"]
    process = subprocess.Popen([nsfc, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        while not (folder / "trials.csv").exists() and process.poll() is None:
            time.sleep(0.1)
        process.send_signal(number)
        _, messages = process.communicate()
    finally:
        process.kill()
    assert process.returncode == code, messages
    assert "the same command goes on" in messages or code == 143
    assert "Traceback" not in messages
    study = open_study(address(None, folder, "nsfc-denoiser"), _stored(folder))
    assert not [trial for trial in study.trials if trial.state.name == "RUNNING"]
    assert (folder / "report.html").exists()
