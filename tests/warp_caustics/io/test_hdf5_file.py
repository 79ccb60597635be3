"""HDF5 files where there is no room for them."""

import subprocess
import sys

import h5py
import numpy as np
import pytest

from warp_caustics.io.hdf5_file import new_hdf5

LIMITED = """
import resource, sys
from pathlib import Path
import numpy as np
from warp_caustics.errors import ResourceError
from warp_caustics.io.atomic import atomic_path
from warp_caustics.io.hdf5_file import new_hdf5
from warp_caustics.io.heights import write_heights
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, resource.RLIM_INFINITY))
values = np.random.default_rng(1).uniform(0, 1e-3, (128, 128))
try:
    if sys.argv[1] == "heights":
        write_heights("file.h5", values)
    else:
        with atomic_path("file.h5") as temporary, new_hdf5(temporary) as file:
            file["image"] = values
except ResourceError as error:
    print(error)
"""


@pytest.mark.parametrize("what", ["heights", "image"])
def test_a_limit_of_file_sizes_is_one_line(tmp_path, what):
    """HDF5 itself tries again when the process ends, with tracebacks or a crash."""
    ran = subprocess.run([sys.executable, "-c", LIMITED, what], capture_output=True, text=True, cwd=tmp_path)
    assert (ran.returncode, ran.stderr) == (0, "")
    assert len(ran.stdout.splitlines()) == 1 and "raise the limit of file sizes (ulimit -f)" in ran.stdout
    assert list(tmp_path.iterdir()) == []


def test_what_is_written_is_read(tmp_path):
    values = np.random.default_rng(1).standard_normal((5, 4))
    with new_hdf5(tmp_path / "file.h5") as file:
        file["values"] = values
    with h5py.File(tmp_path / "file.h5") as file:
        np.testing.assert_array_equal(file["values"][()], values)


def test_nothing_is_written_where_the_block_fails(tmp_path):
    with pytest.raises(ValueError, match="inside"), new_hdf5(tmp_path / "file.h5") as file:
        file["values"] = [1.0]
        raise ValueError("inside")
    assert list(tmp_path.iterdir()) == []
