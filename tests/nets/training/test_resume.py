"""P13: an interrupted training continues as if nothing had happened."""

import shutil

import pytest
import torch

from nets.training.checkpoint import load_checkpoint, save_checkpoint
from nets.training.record import read_metrics
from warp_caustics.errors import MismatchError

STOPS = (1, 3, 4, 5, 8, 11)
"""Steps; epochs end at 4, 8 and 12, reports come at 2, 4, ..."""


def everything(folder):
    """What two equal runs have in common, by name."""
    state = load_checkpoint(folder / "checkpoints" / "last.ckpt")
    found = {}

    def collect(value, name):
        if isinstance(value, dict):
            for key, item in value.items():
                collect(item, f"{name}/{key}")
        elif isinstance(value, list | tuple):
            for key, item in enumerate(value):
                collect(item, f"{name}/{key}")
        else:
            found[name] = value

    collect({key: value for key, value in state.items() if key != "elapsed_s"}, "")
    timings = ("elapsed_s", "samples_per_s", "simulator_share")
    for row in read_metrics(folder):
        kept = {key: value for key, value in row.items() if key not in timings}
        found[f"metrics/{row['step']}/{'loss' if row['loss'] else 'validation'}"] = str(kept)
    return found


def differences(a, b):
    assert a.keys() == b.keys()
    return [k for k in a if not (torch.equal(a[k], b[k]) if isinstance(a[k], torch.Tensor) else a[k] == b[k])]


@pytest.fixture
def run_config(tiny_run):
    """Everything that has a state: replay pool, growing K, network memory, cosine, average, patience."""
    return tiny_run(
        "unrolled",
        schedule="cosine",
        warmup_steps=3,
        ema_decay=0.9,
        patience=5,
        batch_size=2,
        replay={"size": 6, "fresh_per_step": 1},
        unrolling={"last_steps": 2},
        validation={"count": 2},
        photons=[{"photons_per_pixel": 1.0}, {"photons_per_pixel": 1.0, "placement": "stratified"}],
        log_every_steps=2,
    )


@pytest.fixture
def straight(run_config, train, tmp_path):
    train(run_config, tmp_path / "straight")
    return everything(tmp_path / "straight")


def test_six_stops_give_the_same_run_bit_for_bit(run_config, train, tmp_path, straight):
    folder = tmp_path / "parts"
    for count, stop in enumerate(STOPS):
        result = train(run_config, folder, max_steps=stop, resume=count > 0)
        assert (result.stop_reason, result.step) == ("max_steps", stop)
        # A copy that is finished from here on.
        shutil.copytree(folder, tmp_path / f"from {stop}")
        assert train(run_config, tmp_path / f"from {stop}", resume=True).stop_reason == "finished"
        assert differences(everything(tmp_path / f"from {stop}"), straight) == []
    train(run_config, folder, resume=True)
    assert differences(everything(folder), straight) == []


def forget_average(state):
    state["average"] = state["network"]


def forget_optimiser(state):
    state["optimiser"]["state"] = {}


def forget_step(state):
    state["step"] -= 1


def forget_waiting(state):
    state["stopping"] = {**state["stopping"], "waited": 7}


def forget_best(state):
    state["stopping"] = {**state["stopping"], "best": 1e-9}


def forget_gradients(state):
    state["mean_norm"] = torch.zeros(())


def forget_losses(state):
    state["loss_sum"], state["loss_count"] = torch.zeros(()), 0


FORGETTING = (
    forget_average,
    forget_optimiser,
    forget_step,
    forget_waiting,
    forget_best,
    forget_gradients,
    forget_losses,
)


def test_what_is_forgotten_is_caught(run_config, train, tmp_path):
    """Two steps later, before a validation that finds a better network makes it forget by right what it waited."""
    train(run_config, tmp_path / "base", max_steps=5)
    shutil.copytree(tmp_path / "base", tmp_path / "whole")
    train(run_config, tmp_path / "whole", max_steps=7, resume=True)
    whole = everything(tmp_path / "whole")
    for forget in FORGETTING:
        folder = tmp_path / forget.__name__
        shutil.copytree(tmp_path / "base", folder)
        state = load_checkpoint(folder / "checkpoints" / "last.ckpt")
        forget(state)
        save_checkpoint(folder / "checkpoints", state)
        train(run_config, folder, max_steps=7, resume=True)
        assert differences_or_missing(everything(folder), whole), forget.__name__


def differences_or_missing(a, b):
    return a.keys() ^ b.keys() or differences(a, b)


def test_rows_of_a_lost_life_are_dropped(run_config, train, tmp_path):
    folder = tmp_path / "run"
    train(run_config, folder, max_steps=2)
    shutil.copytree(folder / "checkpoints", tmp_path / "kept")
    train(run_config, folder, max_steps=6, resume=True)
    shutil.rmtree(folder / "checkpoints")
    shutil.move(tmp_path / "kept", folder / "checkpoints")
    with open(folder / "metrics.csv", "a") as file:
        file.write("8,1,2.5")  # the computer stopped while writing
    (folder / "checkpoints" / ".tmp-0123456789abcdef.ckpt").write_bytes(b"half")
    train(run_config, folder, max_steps=4, resume=True)
    assert not list((folder / "checkpoints").glob(".*"))
    assert [row["step"] for row in read_metrics(folder)] == ["2", "4", "4"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"network": {"numbered_steps": 5}}, "network differs"),
        ({"seed": 4}, "seed 4 differs from the run's 0"),
    ],
)
def test_another_run_is_not_continued(tiny_run, train, tmp_path, change, message):
    train(tiny_run("unrolled"), tmp_path / "run", max_steps=1)
    with pytest.raises(MismatchError, match=message):
        train(tiny_run("unrolled", **change), tmp_path / "run", resume=True)


def test_a_longer_run_goes_on(tiny_run, train, tmp_path, watcher):
    train(tiny_run("direct", total_steps=2), tmp_path / "run")
    assert train(tiny_run("direct", total_steps=2), tmp_path / "run", resume=True, watcher=watcher).step == 2
    assert watcher.notes == ["nothing to do, the run is at its end (finished); --total-steps or --total-time extend it"]
    assert train(tiny_run("direct", total_steps=3), tmp_path / "run", resume=True).step == 3


def test_a_run_killed_before_its_first_checkpoint_begins_again(tiny_run, train, tmp_path, watcher):
    config = tiny_run("direct", total_steps=2, replay={"size": 8, "fresh_per_step": 2})
    assert train(config, tmp_path / "run", resume=True, watcher=watcher).step == 2
    assert watcher.notes == ["pool       8 samples, 0.00 GiB on cpu"]


def test_another_number_of_devices_is_told(tiny_run, train, tmp_path, watcher):
    """A run of four that goes on alone learns from a quarter of the samples per step: nobody should find out late."""
    config = tiny_run("direct", total_steps=3)
    train(config, tmp_path / "run", max_steps=1)
    folder = tmp_path / "run" / "checkpoints"
    save_checkpoint(folder, load_checkpoint(folder / "last.ckpt") | {"processes": 4})
    train(config, tmp_path / "run", resume=True, watcher=watcher)
    (told,) = watcher.warnings
    assert "on 4 devices and goes on with 1" in told and "--devices 4" in told
