"""A file appears complete or not at all, and only files are replaced."""

import errno
import os
from pathlib import Path

import pytest

from warp_caustics.errors import InputError, ResourceError
from warp_caustics.io import atomic_path, durable
from warp_caustics.io.durable import SystemCalls


def test_atomic_path_replaces_only_files(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    for name, text in (("folder", "a folder"), ("pipe", "a pipe")):
        with pytest.raises(InputError, match=text), atomic_path(tmp_path / name):
            pytest.fail("the block must not run")
    (tmp_path / "target.npy").write_bytes(b"old")
    (tmp_path / "link.npy").symlink_to("target.npy")
    with atomic_path(tmp_path / "link.npy") as temporary:
        assert temporary.parent == tmp_path and temporary.suffix == ".npy"
        temporary.write_bytes(b"new")
        assert (tmp_path / "target.npy").read_bytes() == b"old"
    assert (tmp_path / "target.npy").read_bytes() == b"new" and (tmp_path / "link.npy").is_symlink()


@pytest.mark.parametrize(
    ("name", "k"), [("open", 1), ("fsync", 1), ("close", 1), ("replace", 1), ("open", 2), ("fsync", 2), ("close", 2)]
)
def test_disk_that_fails_at_any_step_leaves_a_whole_file(monkeypatch, tmp_path, name, k):
    calls = SystemCalls()
    count = 0

    def fail(*arguments):
        nonlocal count
        count += 1
        if name == "close" or count != k:
            done = getattr(SystemCalls(), name)(*arguments)
        if count == k:
            raise OSError(errno.EIO, "Input/output error")
        return done

    setattr(calls, name, fail)
    monkeypatch.setattr(durable, "CALLS", calls)
    (tmp_path / "file").write_bytes(b"old")
    with pytest.raises(ResourceError, match="Input/output error"), atomic_path(tmp_path / "file") as temporary:
        temporary.write_bytes(b"new")
    # The last steps sync the folder: the file has its new name then, but a power failure may take it back.
    assert (tmp_path / "file").read_bytes() == (b"new" if k == 2 else b"old")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize(
    ("raised", "mend"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), "free space"),
        (OSError("Unable to flush file: No space left on device"), "free space"),
        (OSError("1024 requested and 234 written"), r"free space or raise the limit of file sizes \(ulimit -f\)"),
        (OSError(errno.EFBIG, "File too large"), r"raise the limit of file sizes \(ulimit -f\)"),
        (OSError(errno.EMFILE, "Too many open files"), r"raise the limit of open files \(ulimit -n\)"),
    ],
)
def test_what_the_machine_lacks_is_no_bug(tmp_path, raised, mend):
    with pytest.raises(ResourceError, match=f"cannot write .*{mend}$"), atomic_path(tmp_path / "file"):
        raise raised
    assert not list(tmp_path.iterdir())
