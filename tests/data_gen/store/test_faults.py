"""The disk fails: every single system call, full disks."""

import errno
import os
import re
import resource
import subprocess
import sys
from pathlib import Path

import pytest
from store_synthetic import everything, factory, make_config, shard_bytes, temporaries

from data_gen.store import build
from warp_caustics.errors import CausticsError, InputError, ResourceError
from warp_caustics.io import durable
from warp_caustics.io.durable import TEMPORARY_PREFIX, SystemCalls, publish

HERE = Path(__file__).parent
CONFIG = make_config(n_samples=4, samples_per_shard=2)
CALLS = ("open", "write", "read", "fsync", "close", "replace", "mkdir")


MENDED = {
    ("fsync", "written file"),
    ("fsync", "folder after replace"),
    ("close", "written file"),
    ("close", "folder after replace"),
    ("open", "folder after replace"),
}
"""Calls, and what on, after whose EIO a file is written again; all others are reported."""


class Faulty(SystemCalls):
    """Fails the k-th call of a name, counted from 1; all later ones too if asked. Notes what it failed on first."""

    def __init__(self, name, k, code, for_ever=False):
        self.name, self.k, self.code, self.for_ever = name, k, code, for_ever
        self.count, self.failed_on = 0, None
        self.subjects, self.last_change = {}, "nothing"

    def _done(self, name, subject, call):
        if name != self.name:
            return call()
        self.count += 1
        if self.count < self.k or (self.count > self.k and not self.for_ever):
            return call()
        self.failed_on = self.failed_on or subject
        if name == "close":
            # As Linux does: the descriptor is gone even if close reports an error.
            call()
        raise OSError(self.code, os.strerror(self.code))

    def open(self, path, flags):
        is_written = flags & os.O_CREAT and path.name != ".lock"
        kind = f"folder after {self.last_change}" if path.is_dir() else "written file" if is_written else "other file"
        descriptor = self._done("open", kind, lambda: SystemCalls.open(self, path, flags))
        self.subjects[descriptor] = kind
        return descriptor

    def write(self, descriptor, data):
        return self._done("write", self.subjects[descriptor], lambda: SystemCalls.write(self, descriptor, data))

    def read(self, descriptor, count):
        return self._done("read", self.subjects[descriptor], lambda: SystemCalls.read(self, descriptor, count))

    def fsync(self, descriptor):
        return self._done("fsync", self.subjects[descriptor], lambda: SystemCalls.fsync(self, descriptor))

    def close(self, descriptor):
        return self._done("close", self.subjects[descriptor], lambda: SystemCalls.close(self, descriptor))

    def replace(self, source, target):
        self.last_change = "replace"
        return self._done("replace", "file", lambda: SystemCalls.replace(self, source, target))

    def mkdir(self, path):
        self.last_change = "mkdir"
        return self._done("mkdir", "folder", lambda: SystemCalls.mkdir(self, path))


def assert_published_right(folder, whole):
    """Each manifest stands beside the right shard, COMPLETE.json beside all of them, nothing temporary is left."""
    found = everything(folder) if folder.exists() else {}
    for name, data in found.items():
        assert data == whole[name], name
    for name in found:
        if name.endswith("0.json") or name.endswith("1.json"):
            assert name.replace(".json", ".h5") in found
    if "COMPLETE.json" in found:
        assert found == whole


def fail_each_call(monkeypatch, folder, name, code, for_ever=False):
    """Fails the first, second ... call until a build does not get that far.

    Returns:
        What came out and what the call was on, of each.
    """
    whole_folder = folder.with_name("whole")
    build(whole_folder, CONFIG, factory())
    whole, found = everything(whole_folder), []
    for k in range(1, 200):
        place = folder.with_name(f"{name}-{k}")
        descriptors = len(os.listdir("/proc/self/fd"))
        calls = Faulty(name, k, code, for_ever)
        monkeypatch.setattr(durable, "CALLS", calls)
        try:
            build(place, CONFIG, factory())
            outcome = "finished"
        except CausticsError as error:
            outcome = type(error).__name__
            assert len(str(error).splitlines()) == 1
            assert "run the same command again to resume" in str(error), error
            if isinstance(error, ResourceError):
                assert error.exit_code == 6 and str(place) in str(error)
                assert "bytes needed" in str(error) and "free" in str(error)
        finally:
            monkeypatch.setattr(durable, "CALLS", SystemCalls())
        assert len(os.listdir("/proc/self/fd")) == descriptors, "a file stayed open"
        assert_published_right(place, whole)
        assert not temporaries(place)
        assert outcome != "finished" or everything(place) == whole
        if calls.failed_on is None:
            assert outcome == "finished"
            return found
        found.append((outcome, calls.failed_on))
        build(place, CONFIG, factory())
        assert everything(place) == whole
    raise AssertionError("no end")


@pytest.mark.parametrize("name", CALLS)
def test_full_disk_at_every_call(monkeypatch, folder, name):
    found = fail_each_call(monkeypatch, folder, name, errno.ENOSPC)
    assert {outcome for outcome, _ in found} == {"ResourceError"}


@pytest.mark.parametrize("name", CALLS)
def test_disk_error_at_every_call(monkeypatch, folder, name):
    """One EIO of fsync or close, of a published file and of its folder, is mended by writing the file again."""
    found = fail_each_call(monkeypatch, folder, name, errno.EIO)
    for outcome, subject in found:
        assert outcome == ("finished" if (name, subject) in MENDED else "ResourceError"), subject
    # All that can be mended was tried, and so was what cannot: new folders, the lock, files that are read back.
    assert {(name, subject) for outcome, subject in found if outcome == "finished"} == {
        pair for pair in MENDED if pair[0] == name
    }
    assert any(outcome == "ResourceError" for outcome, _ in found)


@pytest.mark.slow
@pytest.mark.parametrize("name", CALLS)
@pytest.mark.parametrize("code", [errno.EDQUOT, errno.EXDEV])
def test_other_errors_at_every_call(monkeypatch, folder, name, code):
    found = fail_each_call(monkeypatch, folder, name, code)
    expected = "ResourceError" if code == errno.EDQUOT else "CausticsError"
    assert {outcome for outcome, _ in found} == {expected}


@pytest.mark.parametrize("name", CALLS)
def test_interruptions_are_invisible(monkeypatch, folder, name):
    found = fail_each_call(monkeypatch, folder, name, errno.EINTR)
    assert {outcome for outcome, _ in found} == {"finished"}


@pytest.mark.parametrize(("name", "code"), [("write", errno.ENOSPC), ("fsync", errno.EIO), ("close", errno.EDQUOT)])
def test_disk_that_stays_broken_from_every_call_on(monkeypatch, folder, name, code):
    found = fail_each_call(monkeypatch, folder, name, code, for_ever=True)
    assert {outcome for outcome, _ in found} == {"ResourceError"}
    assert "written file" in {subject for _, subject in found}


def test_short_writes(monkeypatch, tmp_path):
    class Short(SystemCalls):
        calls = 0

        def write(self, descriptor, data):
            self.calls += 1
            return super().write(descriptor, data[: 1 + len(data) // 3])

    monkeypatch.setattr(durable, "CALLS", short := Short())
    data = os.urandom(100_000)
    publish(tmp_path / "file", data)
    assert (tmp_path / "file").read_bytes() == data and short.calls > 10


def test_failed_fsync_is_followed_by_a_new_file(monkeypatch, tmp_path):
    """The kernel forgets pages it could not write: a second fsync of the same file says all is well."""
    failed, synced, renamed = [], [], []

    class Forgetful(SystemCalls):
        def fsync(self, descriptor):
            path = os.readlink(f"/proc/self/fd/{descriptor}")
            if not failed:
                failed.append(path)
                raise OSError(errno.EIO, "Input/output error")
            synced.append(path)

        def replace(self, source, target):
            renamed.append((str(source), list(synced)))
            super().replace(source, target)

    monkeypatch.setattr(durable, "CALLS", Forgetful())
    publish(tmp_path / "file", b"content")
    assert os.path.basename(failed[0]).startswith(TEMPORARY_PREFIX) and failed[0] not in synced
    # The file that took the name was on the disk before, and its name is there now.
    ((source, before),) = renamed
    assert source in before and synced[-1] == str(tmp_path)


@pytest.mark.parametrize("times", [1, 2])
def test_disk_that_returns_other_bytes_is_noticed_where_files_are_read_back(monkeypatch, tmp_path, times):
    class Lying(SystemCalls):
        left = times

        def write(self, descriptor, data):
            self.left -= 1
            return super().write(descriptor, memoryview(bytes(len(data))) if self.left >= 0 else data)

    monkeypatch.setattr(durable, "CALLS", Lying())
    if times == 1:
        publish(tmp_path / "file", b"content", reread=True)
        assert (tmp_path / "file").read_bytes() == b"content"
    else:
        with pytest.raises(ResourceError, match="the disk returns other bytes than were written"):
            publish(tmp_path / "file", b"content", reread=True)
        assert list(tmp_path.iterdir()) == []
    # Control: without reading back nobody notices.
    monkeypatch.setattr(durable, "CALLS", Lying())
    publish(tmp_path / "other", b"content")
    assert (tmp_path / "other").read_bytes() == bytes(7)


def test_lost_answer_of_a_rename(monkeypatch, tmp_path):
    """Network file systems repeat a rename whose answer was lost, and then report that the source is missing."""

    class Repeating(SystemCalls):
        def replace(self, source, target):
            super().replace(source, target)
            super().replace(source, target)

    monkeypatch.setattr(durable, "CALLS", Repeating())
    publish(tmp_path / "file", b"content")
    assert (tmp_path / "file").read_bytes() == b"content"


def test_folder_without_permission(monkeypatch, folder):
    monkeypatch.setattr(durable, "CALLS", Faulty("open", 1, errno.EACCES))
    with pytest.raises(InputError, match="choose a folder that this user may write"):
        build(folder, CONFIG, factory())


def run_limited(folder, lines, workers):
    code = (
        f"{lines}\nfrom data_gen.store import build\nfrom store_synthetic import *\n"
        "from warp_caustics.errors import CausticsError\n"
        "if __name__ == '__main__':\n"
        f"    try: build({str(folder)!r}, make_config(400, 40), factory(), workers={workers}, preflight=False)\n"
        "    except CausticsError as error: print(error); raise SystemExit(error.exit_code)\n"
    )
    script = folder.parent / "script.py"
    script.write_text(code)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(HERE), *sys.path])}
    return subprocess.run([sys.executable, script], capture_output=True, text=True, env=environment)


@pytest.mark.parametrize("workers", [0, 1])
def test_limit_of_file_sizes(folder, reference, workers):
    """What a full disk is for those who may not mount one."""
    lines = f"import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (40000, {resource.RLIM_INFINITY}))"
    run = run_limited(folder, lines, workers)
    assert run.returncode == 6 and run.stderr == "", run.stderr
    # A worker writes two shards at once; either may fail first.
    assert len(run.stdout.splitlines()) == 1 and re.search(r"shards/0000[01].h5' \(File too large; ", run.stdout)
    assert "run the same command again to resume" in run.stdout and not temporaries(folder)
    report = build(folder, make_config(400, 40), factory())
    assert report.shards_built == 10


@pytest.mark.parametrize("workers", [0, 2])
def test_full_disk(tmp_path, workers):
    """A real one, of 300 kB; needs the right to mount."""
    disk = tmp_path / "disk"
    disk.mkdir()
    if os.geteuid() or subprocess.run(["mount", "-t", "tmpfs", "-o", "size=300k", "tmpfs", disk]).returncode:
        pytest.skip("needs the right to mount a tmpfs")
    try:
        run = run_limited(disk / "set", "", workers)
        assert run.returncode == 6 and run.stderr == "", run.stderr
        assert "(No space left on device; " in run.stdout and "free space, then run" in run.stdout
        done = shard_bytes(disk / "set")
        assert 0 < len(done) < 10 and not temporaries(disk)
        subprocess.run(["mount", "-o", "remount,size=30m", disk], check=True)
        build(disk / "set", make_config(400, 40), factory())
        build(tmp_path / "whole", make_config(400, 40), factory())
        assert shard_bytes(disk / "set") == shard_bytes(tmp_path / "whole")
        assert done.items() <= shard_bytes(disk / "set").items()
    finally:
        subprocess.run(["umount", disk], check=True)
