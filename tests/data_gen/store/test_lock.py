"""One builder per folder."""

import json
import os
import socket
import subprocess
import sys
import threading
import time

import pytest
from store_synthetic import factory, make_config, shard_bytes

from data_gen.store import build, builder, lock
from data_gen.store.lock import GRACE_S, BuildLock
from warp_caustics.errors import CausticsError, InputError, MismatchError


@pytest.fixture
def path(folder):
    folder.mkdir()
    return folder / ".lock"


def test_second_builder_is_refused_without_waiting_naming_the_first(path, monkeypatch):
    slept = []
    with BuildLock(path):
        monkeypatch.setattr(lock.time, "sleep", slept.append)
        with pytest.raises(MismatchError) as error:
            build(path.parent, make_config(), factory())
        monkeypatch.undo()
    assert slept == []
    assert f"being built by process {os.getpid()} on {socket.gethostname()}" in str(error.value)
    assert error.value.exit_code == 5
    assert build(path.parent, make_config(), factory()).shards_built == 10


def test_builder_in_another_process_is_named(path):
    code = (
        "import sys, pathlib; from data_gen.store.lock import BuildLock\n"
        f"with BuildLock(pathlib.Path({str(path)!r})): print('in', flush=True); sys.stdin.read()"
    )
    process = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    process.stdout.readline()
    with pytest.raises(MismatchError, match=f"process {process.pid} on "):
        BuildLock(path).__enter__()
    # Once it is dead, on this host, nobody has to wait for the grace time.
    process.kill()
    process.communicate()
    assert path.read_bytes() != b""
    with BuildLock(path):
        pass
    assert path.read_bytes() == b""


def write_lease(path, age_s):
    path.write_text(json.dumps({"host": "node17", "pid": 4242, "nonce": "0"}))
    now = time.time()
    os.utime(path, (now - age_s, now - age_s))


def test_live_builder_on_another_host_is_respected_and_a_dead_one_is_not(path):
    write_lease(path, 20)
    with pytest.raises(
        MismatchError, match=r"process 4242 on node17; wait for it; if it is dead, try again in (39|40) s"
    ):
        BuildLock(path).__enter__()
    write_lease(path, 61)
    with BuildLock(path):
        assert json.loads(path.read_text())["pid"] == os.getpid()


def test_a_lease_from_the_future_blocks_for_the_grace_time_and_not_for_years(path):
    """A builder whose clock was three years ahead; once it is dead, nobody touches the lease again."""
    write_lease(path, -94694458)
    with pytest.raises(MismatchError, match=r"node17; its last sign of life is dated 26,304 h ahead .* in 60 s$"):
        BuildLock(path).__enter__()
    with pytest.raises(MismatchError, match="node17; wait for it; if it is dead, try again in (59|60) s"):
        BuildLock(path).__enter__()
    write_lease(path, -3600)  # it lives, and touches the lease by its own clock
    with pytest.raises(MismatchError, match="1 h ahead"):
        BuildLock(path).__enter__()
    write_lease(path, 61)
    with BuildLock(path):
        pass


@pytest.mark.parametrize("skew_s", [-600.0, 600.0])
def test_clocks_of_the_hosts_do_not_matter(path, monkeypatch, skew_s):
    """Signs of life are dated by the file system; a builder's own clock, off by ten minutes, is never asked."""
    write_lease(path, 20)
    true_time = time.time
    monkeypatch.setattr(time, "time", lambda: true_time() + skew_s)
    with pytest.raises(MismatchError, match="node17"):
        BuildLock(path).__enter__()


def test_signs_of_life_keep_a_lease(path):
    with BuildLock(path, beat_s=0.05):
        # Again and again, and by the file system's clock.
        for _ in range(3):
            os.utime(path, (0, 0))
            while path.stat().st_mtime == 0:
                time.sleep(0.01)
            assert abs(path.stat().st_mtime - time.time()) < GRACE_S


def test_host_that_was_taken_for_dead_notices(path):
    with BuildLock(path) as held:
        held.check()
        write_lease(path, 0)
        with pytest.raises(MismatchError, match="process 4242 on node17 took over"):
            held.check()
    # Not ours any more, so not ours to empty.
    assert "node17" in path.read_text()


def test_builder_that_was_taken_for_dead_stops_and_leaves_files_of_the_other_alone(path):
    def take_over(state):
        if state.done == 8:
            write_lease(path, 0)
            (path.parent / "shards" / ".tmp-00000000000000ab").touch()

    with pytest.raises(MismatchError, match="node17 took over"):
        build(path.parent, make_config(), factory(), progress=take_over)
    assert (path.parent / "shards" / ".tmp-00000000000000ab").exists() and len(shard_bytes(path.parent)) == 2
    # The next one waits for nobody once the other is silent, and cleans up.
    os.utime(path, (0, 0))
    build(path.parent, make_config(), factory())
    assert not (path.parent / "shards" / ".tmp-00000000000000ab").exists()


def test_without_flock_the_lease_alone_keeps_others_out(path, monkeypatch):
    def unsupported(descriptor, operation):
        raise OSError(lock.errno.ENOLCK, "No locks available")

    monkeypatch.setattr(lock.fcntl, "flock", unsupported)
    with BuildLock(path), pytest.raises(MismatchError, match=f"process {os.getpid()}"):
        BuildLock(path).__enter__()


@pytest.mark.parametrize("content", [b"{", b'{"host": "a', b'{"host": 3}'])
def test_unreadable_lease_is_someones(path, content):
    path.write_bytes(content)
    with pytest.raises(MismatchError, match="unknown"):
        BuildLock(path).__enter__()
    os.utime(path, (0, 0))
    with BuildLock(path):
        pass


def test_builders_racing_without_a_lock_write_the_same(folder, reference, monkeypatch):
    """The lock saves work only; data do not depend on it."""

    class NoLock:
        lost = False

        def __init__(self, path):
            pass

        def __enter__(self):
            return self

        def __exit__(self, *exception):
            pass

        def check(self):
            pass

    monkeypatch.setattr(builder, "BuildLock", NoLock)
    # They would sweep each other's temporary files, which is what the lock is there for.
    monkeypatch.setattr(builder, "sweep", lambda *folders: None)
    for race in range(10):
        place, errors = folder.with_name(f"race-{race}"), []

        threads = [threading.Thread(target=build_and_note, args=(place, errors)) for _ in range(2)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        # The one that is a moment late may find shards before config.json; it says so and stops.
        assert len(errors) <= 1 and all(isinstance(error, CausticsError) for error in errors), errors
        assert shard_bytes(place) == shard_bytes(reference)
        assert (place / "COMPLETE.json").read_bytes() == (reference / "COMPLETE.json").read_bytes()


def build_and_note(place, errors):
    try:
        build(place, make_config(), factory())
    except Exception as error:
        errors.append(error)


@pytest.mark.parametrize("content", [b"[]", b"\xff\xfe", b'"x"', b"my notes\n"])
def test_a_file_of_somebody_else_is_no_lock(path, content):
    path.write_bytes(content)
    with pytest.raises(InputError, match="in the place of the lock"):
        BuildLock(path).__enter__()
    assert path.read_bytes() == content


def test_a_link_in_the_place_of_the_lock_is_not_followed(path, tmp_path):
    victim = tmp_path / "thesis.tex"
    victim.write_text("years of work")
    path.symlink_to(victim)
    with pytest.raises(InputError, match="in the place of the lock"):
        BuildLock(path).__enter__()
    assert victim.read_text() == "years of work" and path.is_symlink()


def test_nothing_is_locked_before_the_folder_is_known_as_ours(folder):
    folder.mkdir()
    (folder / "config.json").write_text('{"name": "somebody\'s app"}')
    with pytest.raises(InputError, match="is no data set's; give an empty folder"):
        build(folder, make_config(), factory())
    assert [path.name for path in folder.iterdir()] == ["config.json"]
