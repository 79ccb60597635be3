"""Workers that die, hang, raise or disagree."""

import os
import signal
from pathlib import Path

import pytest
from store_synthetic import (
    DifferingSampler,
    MeetingSampler,
    dying_factory,
    factory,
    failing_factory,
    make_config,
    meeting_factory,
    shard_bytes,
    temporaries,
)

from data_gen.store import build, verify
from data_gen.store.supervise import Supervisor, WorkerError
from warp_caustics.errors import DamagedDataError, InputError, MismatchError, ResourceError

ENDS = {
    "kill": ("died of SIGKILL", {}),
    "segfault": ("died of SIGSEGV", {}),
    "exit": ("ended with exit code 7", {}),
    "stop": ("gave no sign of life for 2 s", {"hang_s": 2.0}),
    "sleep": ("took longer than 2 s", {"shard_timeout_s": 2.0}),
}


def children():
    """Processes of this one that are alive."""
    text = Path(f"/proc/self/task/{os.getpid()}/children").read_text()
    states = {pid: Path(f"/proc/{pid}/cmdline").read_text() for pid in text.split()}
    return [pid for pid, command in states.items() if "spawn_main" in command]


@pytest.mark.parametrize("end", sorted(ENDS))
def test_death_of_a_worker_costs_nothing_but_time(folder, reference, tmp_path, end):
    expected, limits = ENDS[end]
    seen = []
    sampler = factory(trouble=end, at=17, once=str(tmp_path / "once"))
    build(folder, make_config(), sampler, workers=2, notice=seen.append, **limits)
    assert shard_bytes(folder) == shard_bytes(reference) and not temporaries(folder)
    # The cause tells how the parent learned of it: of a death at once through the pipe, not after a silence of 60 s.
    blamed = [text for text in seen if "at shard 4; made again (1 of 3)" in text]
    assert len(blamed) == 1 and expected in blamed[0], seen
    assert children() == []


def test_shard_that_kills_three_workers_is_named_and_the_rest_is_built(folder, reference):
    with pytest.raises(DamagedDataError) as error:
        build(folder, make_config(), factory(trouble="kill", at=17), workers=2)
    assert error.value.exit_code == 4
    assert "1 of 10 shards could not be made" in str(error.value)
    assert "shard 4 (samples 16 to 19): died of SIGKILL, died of SIGKILL, died of SIGKILL; all others" in str(
        error.value
    )
    expected = shard_bytes(reference)
    del expected["00004.h5"]
    assert shard_bytes(folder) == expected and not (folder / "COMPLETE.json").exists()
    assert build(folder, make_config(), factory()).shards_built == 1
    assert shard_bytes(folder) == shard_bytes(reference)


@pytest.mark.parametrize(
    ("trouble", "error", "message"),
    [
        ("raise", WorkerError, r"^shard 4: ValueError: the glass is too thin \(store_synthetic.py:\d+\)$"),
        ("memory", ResourceError, "^shard 4: MemoryError.*take fewer samples per shard"),
        ("nan", InputError, "sample 17: heights has 1 of 64 values"),
    ],
)
def test_exception_of_a_worker_comes_back_with_its_message(folder, trouble, error, message):
    with pytest.raises(error, match=message):
        build(folder, make_config(), factory(trouble=trouble, at=17), workers=1)
    assert children() == [] and not temporaries(folder)
    assert verify(folder).problems == ()


def test_factory_that_fails_or_dies(folder):
    with pytest.raises(WorkerError, match="RuntimeError: no such device here"):
        build(folder, make_config(), failing_factory, workers=2)
    notices = []
    with pytest.raises(ResourceError, match="3 workers died while starting, the last one ended with exit code 9"):
        build(folder, make_config(), dying_factory, workers=1, notice=notices.append)
    assert len(notices) == 2 and children() == []


@pytest.mark.parametrize("deaths", [1, 3])
def test_worker_that_dies_with_shards_of_which_it_began_none(folder, reference, monkeypatch, deaths):
    """No shard can be blamed: it is told all the same, and not tried for ever."""
    send, killed = Supervisor._send, []

    def send_to_the_dead(self, worker, task):
        if len(killed) < deaths and worker.process.pid not in killed:
            killed.append(worker.process.pid)
            worker.process.kill()
            worker.process.join()
        send(self, worker, task)

    monkeypatch.setattr(Supervisor, "_send", send_to_the_dead)
    notices = []
    if deaths == 1:
        build(folder, make_config(), factory(), workers=1, notice=notices.append)
        assert shard_bytes(folder) == shard_bytes(reference)
    else:
        with pytest.raises(ResourceError, match="3 workers died while starting, the last one died of SIGKILL"):
            build(folder, make_config(), factory(), workers=1, notice=notices.append)
    assert len(notices) == min(deaths, 2)
    assert all("died of SIGKILL while starting; started again" in text for text in notices)


def test_factory_that_cannot_be_sent_is_refused_at_once(folder):
    with pytest.raises(InputError, match="cannot be sent to workers"):
        build(folder, make_config(), lambda config, device: None, workers=1)


DEVICES = ("cpu:0", "cpu:1")


def test_each_device_has_a_process(folder, tmp_path):
    build(folder, make_config(), meeting_factory(MeetingSampler, tmp_path, DEVICES), workers=1, devices=DEVICES)
    manifests = [path.read_text() for path in folder.glob("shards/*.json")]
    assert {device for device in DEVICES if any(f'"device":"{device}"' in text for text in manifests)} == set(DEVICES)


def test_workers_that_announce_different_fields_are_refused(folder, tmp_path):
    with pytest.raises(MismatchError, match="announce different fields"):
        build(folder, make_config(), meeting_factory(DifferingSampler, tmp_path, DEVICES), workers=2, devices=DEVICES)


def test_killed_between_two_writes_of_a_worker(folder, reference):
    """SIGKILL from outside, again and again, while shards are drawn and written at once."""
    killed = []

    def kill_one(state):
        # The dead are listed until the parent has buried them.
        alive = [pid for pid in map(int, children()) if pid not in killed]
        if alive and len(killed) < 4 and state.done > 4 * len(killed):
            killed.append(alive[0])
            os.kill(alive[0], signal.SIGKILL)

    report = build(folder, make_config(), factory(pause_s=0.01), workers=2, progress=kill_one)
    assert len(killed) == 4 and sum("died of SIGKILL" in text for text in report.notices) >= 4
    assert shard_bytes(folder) == shard_bytes(reference) and not temporaries(folder)
