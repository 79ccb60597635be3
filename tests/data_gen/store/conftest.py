"""What the tests of data sets on disk share."""

import os
import shutil
import sys
import tempfile
from pathlib import Path

import pytest

HERE = str(Path(__file__).parent)
# Spawned workers get this path too, and so find the samplers.
if HERE not in sys.path:
    sys.path.insert(0, HERE)


@pytest.fixture
def folder(tmp_path):
    """Place for a data set, in memory where that is possible: fsync on a disk takes most of a small build's time."""
    memory = Path("/dev/shm")
    if not os.access(memory, os.W_OK):
        yield tmp_path / "set"
        return
    place = Path(tempfile.mkdtemp(prefix="nsfc-test-", dir=memory))
    yield place / "set"
    shutil.rmtree(place)


@pytest.fixture(scope="session")
def reference(tmp_path_factory):
    """Finished data set of 10 shards with 4 samples each; not to be changed."""
    from store_synthetic import factory, make_config

    from data_gen.store import build

    place = tmp_path_factory.mktemp("reference") / "set"
    build(place, make_config(), factory())
    return place


@pytest.fixture
def copied(reference, folder):
    """A copy of the reference that a test may damage."""
    shutil.copytree(reference, folder)
    return folder
