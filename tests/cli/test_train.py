"""``nsfc train``."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml

from cli.main import main
from cli.options import duration
from warp_caustics.errors import InputError

TINY = [
    "--device", "cpu", "--precision", "32", "--batch-size", "2",
    *(f"--set={setting}" for setting in (
        "scene.height_samples=16", "scene.image_pixels=64", "training.validation.count=2",
        "training.steps_per_epoch=4", "training.log_every_steps=2", "training.photons=[{photons_per_pixel: 1}]",
        "network.backbone={widths: [8, 16], depths: [1, 1], attention_levels: []}",
    )),
]  # fmt: skip


def train(*arguments):
    return main(["train", *map(str, arguments)])


def refused(capsys, *arguments):
    """Exit code and message; one line and nothing on stdout."""
    code = train(*arguments)
    captured = capsys.readouterr()
    assert captured.out == "" and captured.err.count("\n") == 1, captured.err
    return code, captured.err


def test_a_run_its_continuation_and_its_record(tmp_path, capsys):
    run = tmp_path / "run"
    assert train("direct", "--fresh", "-o", run, *TINY, "--total-steps", 8, "--max-steps", 5) == 0
    captured = capsys.readouterr()
    assert "5 steps" in captured.out and "stopped by max steps" in captured.out
    assert "validation RMSE" in captured.err
    names = {path.name for path in run.iterdir()}
    expected = {"config.resolved.yaml", "metrics.csv", "checkpoints", "pictures", "tensorboard", "weights.safetensors"}
    assert names == expected | {".lock", ".nsfc.json"}
    resolved = yaml.safe_load((run / "config.resolved.yaml").read_text())
    assert resolved["kind"] == "direct" and resolved["training"]["total_steps"] == 8
    assert train("direct", "-o", run, "--resume", "--device", "cpu", "--json") == 0
    captured = capsys.readouterr()
    record = json.loads(captured.out)
    assert (record["stop_reason"], record["step"]) == ("finished", 8)
    assert record["objective"] == "val_rmse_um" and record["best"] > 0
    assert record["config"]["scene"]["height_samples"] == 16


def test_an_earlier_run_is_not_overwritten(tmp_path, capsys):
    run = tmp_path / "run"
    fresh = ("direct", "--fresh", "-o", run, *TINY, "--max-steps", 1)
    assert train(*fresh) == 0
    capsys.readouterr()
    before = (run / "weights.safetensors").read_bytes()
    code, message = refused(capsys, *fresh)
    assert code == 3 and "holds a run; continue it with --resume, or delete it with --force" in message
    assert (run / "weights.safetensors").read_bytes() == before
    assert train(*fresh, "--seed", 3, "--force") == 0
    assert (run / "weights.safetensors").read_bytes() != before
    (run / "notes.txt").write_text("mine")
    capsys.readouterr()
    code, message = refused(capsys, *fresh, "--force")
    assert code == 3 and "holds other files (notes.txt)" in message


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["direct"], 2, "give the folder of a data set or --fresh, and not both"),
        (["direct", "data", "--fresh"], 2, "and not both"),
        (["nothing", "--fresh"], 2, "'nothing' is not one of"),
        (["direct", "--fresh", "--max-time", "8 minutes"], 2, "'8 minutes' is no time; write for example 90s"),
        (["direct", "--fresh", "--max-time", "0"], 2, "is no time"),
        (["direct", "--fresh", "--devices", "0"], 2, "--devices 0 is below 1"),
        (["direct", "--fresh", "--preset", "paper"], 3, "preset 'paper' is no direct; use one of direct"),
        (["direct", "--fresh", "--set", "training.lr=1"], 3, "training.lr: unknown key"),
        (["direct", "--fresh", "--set", "training.learning_rate=-1"], 3, "training.learning_rate"),
        (["direct", "--fresh", "--seed", "-1"], 3, "error: --seed: "),
        (["unrolled", "--fresh", "--set", "training.unrolling.start.direct=1"], 3, "give direct_weights"),
        (["direct", "--resume"], 3, "holds no config.resolved.yaml"),
        (["unrolled", "--fresh", "--from-shipped"], 3, "no unrolled network comes with this software"),
        (["direct", "--from-shipped", "--resume"], 2, "--from-shipped does not go with --resume"),
        (["direct", "--fresh", "--config", "family", "--set", "training.bench=null"], 3, "training.scene_share is 0.3"),
        (["direct", "--resume", "--fresh"], 2, "--fresh does not go with --resume"),
        (["updater", "missing"], 3, "missing"),
        (["direct", "--fresh", "--initial-weights", "none.safetensors"], 3, "does not exist"),
        (["direct", "--fresh", "--device", "cuda:99"], 6, "--device cpu"),
    ],
)
def test_refusals(tmp_path, capsys, monkeypatch, arguments, code, message):
    monkeypatch.chdir(tmp_path)
    found, text = refused(capsys, arguments[0], *arguments[1:], "-o", tmp_path / "run")
    assert (found, message in text) == (code, True), text


def test_the_family_of_benches_trains(tmp_path, capsys):
    run = tmp_path / "run"
    settings = [each for each in TINY if "network.backbone" not in each]
    backbone = "network.backbone={widths: [8, 16], depths: [1, 1], attention_levels: [], conditions: 11}"
    arguments = [
        *settings,
        "--set",
        backbone,
        "--total-steps",
        3,
        "--set",
        "training.replay={size: 8, fresh_per_step: 4}",
    ]
    assert train("direct", "--fresh", "--config", "family", "-o", run, *arguments) == 0
    row = (run / "metrics.csv").read_text().splitlines()
    values = dict(zip(row[0].split(","), row[-1].split(","), strict=True))
    assert float(values["val_rmse_um"]) > 0 and float(values["val_unknown_rmse_um"]) > 0
    resolved = yaml.safe_load((run / "config.resolved.yaml").read_text())
    assert len(resolved["training"]["bench"]["prints"]) == 9 and resolved["network"]["backbone"]["conditions"] == 11


def test_shipped_weights_are_a_start(tmp_path, capsys):
    """Of another scene's size they are refused by name: the file was found."""
    run = tmp_path / "run"
    code, message = refused(capsys, "direct", "--fresh", "--from-shipped", "-o", run, *TINY)
    assert code != 0 and "direct.safetensors" in message


def test_a_start_that_failed_is_no_run(tmp_path, capsys):
    run = tmp_path / "run"
    (tmp_path / "none").write_text("no weights")
    code, _ = refused(capsys, "direct", "--fresh", "-o", run, *TINY, "--initial-weights", tmp_path / "none")
    assert code in (3, 4) and (run / "config.resolved.yaml").exists()
    assert train("direct", "--fresh", "-o", run, *TINY, "--max-steps", 1) == 0


def test_durations():
    assert [duration(text) for text in ("90", "90s", "8m", "1.5h", "2d")] == [90, 90, 480, 5400, 172800]


def test_presets_and_configuration_files(tmp_path):
    from cli.train_config import new_run

    paper = new_run("denoiser", "paper", "paper", [], {})
    assert paper == new_run("denoiser", None, None, [], {})
    assert (paper.network.network.c_init, paper.training.learning_rate) == (31, 0.00151)
    assert (paper.training.noisy.n_photons, paper.training.clean.n_photons) == (1_000_000, 16_000_000)
    updater = new_run("updater", "paper", "paper", [], {})
    assert updater.training.lambda_tv == 9.81e-10 and updater.training.optimiser == "adam"
    assert not new_run("updater", "paper-updater-no-gradient", None, [], {}).network.use_gradient
    small = new_run("direct", None, "small", ["training.ema_decay=0"], {"training.seed": 5})
    assert (small.scene.height_samples, small.training.ema_decay, small.training.seed) == (32, 0.0, 5)
    file = tmp_path / "mine.yaml"
    file.write_text("denoiser: {k_down: 3, learning_rate: 0.01}\ntraining: {batch_size: 3}\n")
    mine = new_run("denoiser", None, str(file), [], {})
    assert (mine.network.network.k_down, mine.training.learning_rate, mine.training.batch_size) == (3, 0.01, 3)
    assert new_run("direct", None, str(file), [], {}).training.learning_rate == 1e-3


def test_null_leaves_cameras_out(tmp_path):
    """Also where a run without them is the configuration of another one; a setting below brings them back."""
    from cli.config import dump_config
    from cli.train_config import new_run, resumed_run

    without = new_run("direct", None, None, ["training.camera=null"], {})
    assert new_run("direct", None, None, [], {}).training.camera is not None and without.training.camera is None
    (tmp_path / "config.resolved.yaml").write_text(dump_config(without))
    assert new_run("direct", None, str(tmp_path / "config.resolved.yaml"), [], {}).training.camera is None
    assert resumed_run(tmp_path, [], {}).training.camera is None
    assert resumed_run(tmp_path, ["training.camera.blur_px=1"], {}).training.camera.blur_px == 1


@pytest.mark.parametrize(
    "text",
    [
        "training:",
        "training: {validation: null}",
        "denoiser:",
        "data: {noisy: null}",
        "network:\ndenoiser: {k_down: 3}",
    ],
)
def test_null_is_no_section_of_a_file(tmp_path, text):
    """Nor is one that is taken apart, because the file is for the whole program; values that are null are the kind's."""
    from cli.train_config import new_run

    file = tmp_path / "mine.yaml"
    file.write_text(text + "\n")
    with pytest.raises(InputError, match=r"mine.yaml: (training|denoiser|network|data)[.a-z]* is null; of sections"):
        new_run("denoiser", None, str(file), [], {})
    with pytest.raises(InputError, match="--set training.validation=null: training.validation is null"):
        new_run("denoiser", None, None, ["training.validation=null"], {})
    file.write_text("training: {batch_size: null, validation: {count: null}}\ndata: {noisy: {n_photons: null}}\n")
    assert new_run("denoiser", None, str(file), [], {}) == new_run("denoiser", None, None, [], {})


def started(run, *arguments):
    """A training in a process of its own, from the moment it has a checkpoint."""
    nsfc = Path(sys.executable).with_name("nsfc")
    process = subprocess.Popen(
        [nsfc, "train", *arguments, "-o", run], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    while not (run / "checkpoints" / "last.ckpt").exists() and process.poll() is None:
        time.sleep(0.05)
    assert process.poll() is None, process.stderr.read()
    return process


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_two_processes_do_the_work_of_one(tmp_path):
    """Half the batch in each of two processes: the same samples, and the same learning but for rounding.

    Rounding grows: with the samples of each batch in another order, one process differs from itself by 2e-6 in losses
    and 1.5e-6 in errors after 20 steps, two from one by as much.
    """
    from nets.training.record import read_metrics

    off = [f"--set=training.{name}" for name in ("warmup_steps=0", "camera=null")]
    off.append("--set=training.augmentation.symmetries=false")
    nsfc, errors, losses = Path(sys.executable).with_name("nsfc"), [], []
    for devices, batch in ((1, 4), (2, 2), (1, 2)):
        run = tmp_path / f"{devices} times {batch}"
        command = [nsfc, "train", "direct", "--fresh", "-o", run, *TINY, *off, "--total-steps", "20"]
        options = ["--devices", str(devices), "--batch-size", str(batch)]
        done = subprocess.run([*command, *options], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        errors.append([float(row["val_rmse_um"]) for row in read_metrics(run) if row["val_rmse_um"]])
        losses.append([float(row["loss"]) for row in read_metrics(run) if row["loss"]])
    assert errors[1] == pytest.approx(errors[0], rel=2e-5)
    assert losses[1] == pytest.approx(losses[0], rel=2e-5), "what is reported is of both processes"
    assert errors[2] != pytest.approx(errors[0], rel=1e-3), "control: half the samples learn something else"


@pytest.mark.timeout(900)  # three processes that load torch, in turn where others work
def test_two_processes_train(tmp_path):
    """That they end together when their time is up: ``tests/nets/training/test_together.py``, without a clock."""
    from nets.training.record import read_metrics

    run, nsfc = tmp_path / "run", Path(sys.executable).with_name("nsfc")
    command = [nsfc, "train", "direct", "--fresh", "-o", run, *TINY, "--devices", "2", "--total-steps", "4"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)
    try:
        _, text = process.communicate()
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
    assert process.returncode == 0, text
    rows = read_metrics(run)
    assert rows[-1]["val_rmse_um"] and rows[-1]["step"] == "4"


def test_kill_9_and_ctrl_c(tmp_path, capsys):
    """A killed run goes on from its last checkpoint; an interrupted one from where it was."""
    from nets.training.checkpoint import load_checkpoint

    run = tmp_path / "run"
    fresh = ["direct", "--fresh", *TINY, "--total-steps", "1e6", "--set", "training.checkpoint_steps=2"]
    process = started(run, *fresh)
    os.kill(process.pid, signal.SIGKILL)
    process.communicate()
    saved = load_checkpoint(run / "checkpoints" / "last.ckpt")["step"]
    steps = [int(line.split(",")[0]) for line in (run / "metrics.csv").read_text().splitlines()[1:]]
    assert saved > 0 and saved % 2 == 0 and max(steps, default=0) <= saved + 2
    first = (run / "checkpoints" / "last.ckpt").read_bytes()

    process = started(run, "direct", "--resume", "--device", "cpu")
    while (run / "checkpoints" / "last.ckpt").read_bytes() == first and process.poll() is None:
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, text = process.communicate()
    assert process.returncode == 130, text
    assert "interrupted; continue with nsfc train direct" in text and (run / "weights.safetensors").exists()
    assert load_checkpoint(run / "checkpoints" / "last.ckpt")["step"] > saved


@pytest.mark.parametrize("kind", ["denoiser", "updater"])
def test_the_small_configuration_is_done_in_seconds(kind, tmp_path, capsys):
    """No clock here, machines differ: it makes less than a thousandth of the paper's photons."""
    from cli.train_config import new_run

    small = new_run(kind, None, "small", [], {}).training
    paper = new_run(kind, None, "paper", [], {}).training
    light = [
        (run.noisy.n_photons + run.clean.n_photons) * (run.validation.count + (run.total_steps or 500) * run.batch_size)
        for run in (small, paper)
    ]
    assert paper.clean.n_photons == 16_000_000 and light[0] < 1e-3 * light[1]
    assert train(kind, "--fresh", "-o", tmp_path / "run", "--config", "small", "--device", "cpu") == 0
    captured = capsys.readouterr()
    assert captured.err.startswith("making validation samples: 0 of 4\n")
    assert "step 1, " in captured.err and "estimate  " in captured.err and "8 steps" in captured.out


def test_a_training_on_a_cpu_is_told_how_long_it_takes():
    from cli.train_progress import ESTIMATE_STEPS, Outlook, Pace

    pace = Pace()
    pace.steps = ESTIMATE_STEPS
    pace.recent.extend([(0.0, 1), (20.0, 3)])
    lines = Outlook(500, None, 14_000)(3, pace)
    assert lines == [
        "estimate   10 s a step, first validation after 500, about 83 min",
        "on a CPU   the network that ships took 14000 steps on a GPU, here about 39 h; train on a GPU, or try things out "
        "with --config small",
    ]
    assert Outlook(500, 100)(3, pace) == ["estimate   10 s a step, all 100 about 17 min"]
