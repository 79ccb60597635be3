"""What took time to compute outlives a power failure: every byte is on the disk before the file gets its name."""

import os

import numpy as np
import pytest

from cli.main import main
from nets.architecture import build
from nets.weights import save_weights
from tests.nets.conftest import KINDS, SCENE
from warp_caustics.prints.line import Line, line_relief


class Disk:
    """Files that were synced, by inode, and names given to files that were not."""

    def __init__(self, monkeypatch):
        self.synced: set[int] = set()
        self.unsafe: list[str] = []
        fsync, replace = os.fsync, os.replace

        def synced(descriptor):
            fsync(descriptor)
            self.synced.add(os.fstat(descriptor).st_ino)

        def replaced(source, target):
            if os.path.isfile(source) and os.stat(source).st_ino not in self.synced:
                self.unsafe.append(str(target))
            replace(source, target)

        monkeypatch.setattr(os, "fsync", synced)
        monkeypatch.setattr(os, "replace", replaced)

    def lost(self, *paths):
        """Those of these files and folders that a power failure may take."""
        return self.unsafe + [str(path) for path in paths if path.stat().st_ino not in self.synced]


@pytest.fixture
def disk(monkeypatch):
    return Disk(monkeypatch)


def test_weights(disk, tmp_path):
    path = tmp_path / "network.safetensors"
    save_weights(path, build(KINDS["direct"], SCENE), scene=SCENE, data_fingerprint=None, training={})
    assert not disk.lost(path, tmp_path)


def test_results(disk, tmp_path):
    relief = line_relief([Line((-0.012, -0.01), (0.012, 0.008), 6e-3, 3e-4)], 32, (0.05, 0.05))
    np.save(tmp_path / "heights.npy", relief)
    small = ["--config", "small", "--device", "cpu"]
    assert main(["simulate", str(tmp_path / "heights.npy"), "-o", str(tmp_path / "image.tif"), *small]) == 0
    arguments = ["reconstruct", str(tmp_path / "image.tif"), "-o", str(tmp_path / "result"), "--method", "refine"]
    assert main([*arguments, "--max-iterations", "1", *small]) == 0
    files = [path for path in (tmp_path / "result").iterdir() if path.is_file() and not path.name.startswith(".")]
    assert len(files) >= 6
    assert not disk.lost(tmp_path / "image.tif", *files)
