"""A new HDF5 file, made in memory and written at once."""

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


@contextmanager
def new_hdf5(path: Path) -> Iterator[Any]:
    """An open h5py.File, whose bytes are written to ``path`` when the block ends.

    HDF5 keeps what it could not write and tries again when the file is closed and when the process ends: on a full
    disk it prints tracebacks beside the error, and crashes.

    Raises:
        OSError: the file cannot be written.
    """
    import h5py

    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as file:
        yield file
    path.write_bytes(buffer.getbuffer())
