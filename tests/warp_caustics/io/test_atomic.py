"""A file appears complete or not at all, and only files are replaced."""

import os
from pathlib import Path

import pytest

from warp_caustics.errors import InputError
from warp_caustics.io import atomic_path


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
