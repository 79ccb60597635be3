"""A folder in memory, where that is possible: to wait for a disk takes most of the time of what writes little and often."""

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

MEMORY = Path("/dev/shm")


@contextmanager
def memory_folder(otherwise: Path) -> Iterator[Path]:
    """An empty folder in memory that is deleted afterwards, or the other one where there is no such place."""
    if not os.access(MEMORY, os.W_OK):
        yield otherwise
        return
    place = Path(tempfile.mkdtemp(prefix="nsfc-test-", dir=MEMORY))
    try:
        yield place
    finally:
        shutil.rmtree(place)
