"""kill -9 at any moment, resume, and the data set is the one that would have come out anyway."""

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from store_synthetic import captures, factory, make_config, shard_bytes, temporaries

from data_gen.store import CausticDataset, build, verify
from data_gen.store.layout import Manifest

HERE = Path(__file__).parent


def start(folder, workers, n_samples, per_shard, pause_s, *kind):
    """A build in a process of its own, with its own process group."""
    arguments = map(str, (folder, workers, n_samples, per_shard, pause_s, *kind))
    command = [sys.executable, "-m", "store_synthetic", *arguments]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(HERE), *sys.path])}
    return subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )


def wait_for_end_of_all(process):
    """Workers share the pipe of standard output: it ends when the last of them is gone."""
    output, errors = process.communicate()
    return [int(line) for line in output.split()], errors


def published(folder):
    """Shards with a manifest."""
    manifests = [Manifest.from_bytes(path.read_bytes()) for path in sorted(folder.glob("shards/*.json"))]
    return {manifest.shard for manifest in manifests}


def kill_again_and_again(folder, kills, *, n_samples, seed, configuration=make_config):
    config, chance = configuration(n_samples), random.Random(seed)
    whole = folder.with_name("whole")
    build(whole, config, factory())
    expected = shard_bytes(whole)
    before = set()
    made = 0
    for kill in range(kills):
        process = start(folder, 2, n_samples, 4, 0.03, configuration.__name__)
        # Half of them while workers start, half of them after some shards of this run.
        for _ in range(1 + (chance.randrange(1, 6) if kill % 2 else 0)):
            process.stdout.readline()
        time.sleep(chance.uniform(0.0, 0.6 if kill % 2 == 0 else 0.15))
        # The parent alone, whose workers must follow it; or everybody.
        victim = os.kill if kill % 4 < 2 else os.killpg
        victim(process.pid, signal.SIGKILL)
        wait_for_end_of_all(process)
        assert process.returncode == -signal.SIGKILL
        assert not (folder / "COMPLETE.json").exists(), f"kill {kill} hit a finished build"
        now = published(folder)
        assert before <= now and len(now) < config.n_shards
        files = shard_bytes(folder)
        assert all(files[f"{shard:05d}.h5"] == expected[f"{shard:05d}.h5"] for shard in now)
        made, before = made + len(now - before), now
    assert made > 0
    report = build(folder, config, factory())
    assert report.shards_built == config.n_shards - len(before)
    assert shard_bytes(folder) == expected and not temporaries(folder)
    assert verify(folder).problems == ()
    assert CausticDataset(folder).ids.tolist() == list(range(n_samples))
    return made


def test_killed_4_times(folder):
    """Once each: the parent alone or everybody, while workers start or after some shards."""
    kill_again_and_again(folder, 4, n_samples=240, seed=1)


def test_benches_survive_kills(folder):
    """Rows of named numbers keep the store's promises: nothing lost, nothing doubled, the same bytes."""
    kill_again_and_again(folder, 2, n_samples=120, seed=3, configuration=captures)
    dataset = CausticDataset(folder)
    assert len(dataset.columns("bench")) == dataset[0]["bench"].numel() > 60


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_killed_50_times(folder):
    print(kill_again_and_again(folder, 50, n_samples=2000, seed=2), "shards made in the killed runs")


def test_same_bytes_for_any_number_of_workers(folder, reference):
    for workers in (1, 2, 3):
        place = folder.with_name(f"with-{workers}")
        report = build(place, make_config(), factory(), workers=workers)
        assert report.shards_built == 10 and report.notices == ()
        assert shard_bytes(place) == shard_bytes(reference)
        for name in ("COMPLETE.json", "config.json", "shards/00004.json"):
            assert (place / name).read_bytes() == (reference / name).read_bytes()


def interrupt(folder, signal_number, moment):
    process = start(folder, 2, 200, 4, 0.03)
    for _ in range(moment):
        process.stdout.readline()
    os.kill(process.pid, signal_number)
    _, errors = wait_for_end_of_all(process)
    assert not (folder / "COMPLETE.json").exists() and not temporaries(folder), "hit a finished build, or left a file"
    # An empty lock file: nobody has to guess whether the builder is alive.
    assert (folder / ".lock").read_bytes() == b""
    return process.returncode, errors


@pytest.mark.parametrize("moment", [1, 3])
def test_ctrl_c_and_sigterm_are_orderly(folder, moment):
    code, errors = interrupt(folder, signal.SIGINT, moment)
    assert code == -signal.SIGINT and errors.count("Traceback") == 1 and "KeyboardInterrupt" in errors
    code, errors = interrupt(folder, signal.SIGTERM, moment)
    assert code == 143 and errors == ""
    build(folder, make_config(200), factory())
    build(folder.with_name("whole"), make_config(200), factory())
    assert shard_bytes(folder) == shard_bytes(folder.with_name("whole"))


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_at_10_moments(folder, number):
    for moment in range(1, 11):
        code, _ = interrupt(folder.with_name(str(moment)), number, moment)
        assert code == {signal.SIGINT: -signal.SIGINT, signal.SIGTERM: 143}[number]


def test_sigterm_works_where_ctrl_c_is_ignored(folder):
    """As after nohup: shells start background jobs with SIGINT ignored."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        process = start(folder, 1, 400, 4, 0.03)
    finally:
        signal.signal(signal.SIGINT, before)
    process.stdout.readline()
    process.stdout.readline()
    os.kill(process.pid, signal.SIGINT)
    assert process.stdout.readline() and process.poll() is None
    os.kill(process.pid, signal.SIGTERM)
    wait_for_end_of_all(process)
    assert process.returncode == 143 and not temporaries(folder)
