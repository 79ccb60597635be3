"""Only regular files are opened; a pipe in place of one is refused, not waited for."""

import os
import re
import signal
from contextlib import contextmanager
from pathlib import Path

import pytest

from data_gen.store.layout import read_complete, read_manifest
from warp_caustics.errors import DamagedDataError, InputError
from warp_caustics.io.atomic import regular_file
from warp_caustics.io.csv_table import CsvTable
from warp_caustics.io.hashes import file_sha256
from warp_caustics.io.regular import IrregularFileError, open_regular, read_regular


@contextmanager
def no_waiting():
    """Fails after seconds instead of hanging."""

    def stop(*_):
        raise TimeoutError("waited for a pipe")

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(10)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


@pytest.fixture
def pipe(tmp_path):
    path = tmp_path / "pipe.tif"
    os.mkfifo(path)
    return path


READERS = [
    (open_regular, IrregularFileError),
    (read_regular, IrregularFileError),
    (file_sha256, IrregularFileError),
    (regular_file, InputError),
    (read_manifest, DamagedDataError),
    (read_complete, DamagedDataError),
    (lambda path: CsvTable(path, ("a",)).read(), DamagedDataError),
]


@pytest.mark.parametrize("reader, error", READERS)
def test_a_pipe_is_refused_at_once(pipe, reader, error):
    with no_waiting(), pytest.raises(error, match="is a pipe"):
        reader(pipe)


@pytest.mark.parametrize("reader, error", READERS)
def test_so_is_a_device(reader, error):
    with no_waiting(), pytest.raises(error, match="is a device"):
        reader(Path("/dev/zero"))


def test_more_than_is_read_is_refused(tmp_path):
    (tmp_path / "long").write_bytes(b"x" * 100)
    assert read_regular(tmp_path / "long", 100) == b"x" * 100
    with pytest.raises(IrregularFileError, match="more than 99 bytes"):
        read_regular(tmp_path / "long", 99)


def test_nothing_else_opens_files_for_reading():
    """Every file is opened by ``regular.py``, or looked at by it before a library opens it by its path."""
    root = Path(__file__).parents[3]
    opens = re.compile(r"(?<![\w.])open\((?!.*\"[wax]b?\")|\.open\(|\.read_(?:bytes|text)\(|h5py\.File\(path, \"r\"")
    # What these open was checked just before, is written, or comes with the system or the package.
    checked = {
        "warp_caustics/io": {
            "regular.py",
            "arrays.py",
            "jpeg.py",
            "durable.py",
            "page.py",
            "csv_table.py",
            "journal.py",
            "atomic.py",
        },
        "warp_caustics/prints": {"line_list.py"},
        "warp_caustics": {"device.py"},
        "data_gen/store": {"lock.py", "reader.py"},
        "nets/evaluation": {"meter.py", "code_version.py"},
        "nets/training": {"checkpoint.py"},
        "nets/search": {"worker.py"},
        "cli": {"env.py"},
    }
    found = []
    for package in ("warp_caustics", "data_gen", "nets", "cli"):
        for path in sorted((root / package).rglob("*.py")):
            folder = str(path.relative_to(root).parent)
            if path.name not in checked.get(folder, ()) and opens.search(path.read_text()):
                found.append(f"{folder}/{path.name}")
    assert not found, f"use warp_caustics/io/regular.py in {found}"
