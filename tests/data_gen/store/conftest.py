"""What the tests of data sets on disk share."""

import shutil
import sys
from pathlib import Path

import pytest

from tests.memory_folder import memory_folder

HERE = str(Path(__file__).parent)
# Spawned workers get this path too, and so find the samplers.
if HERE not in sys.path:
    sys.path.insert(0, HERE)


@pytest.fixture
def folder(tmp_path):
    """Place for a data set: fsync on a disk takes most of a small build's time."""
    with memory_folder(tmp_path) as place:
        yield place / "set"


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
