"""Arrays kept on disk between runs, and their hashes."""

import hashlib
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from warp_caustics.io.atomic import atomic_path
from warp_caustics.io.regular import require_regular


def array_hash(array: Any) -> str:
    """sha256 over type, shape and values."""
    dense = np.ascontiguousarray(array)
    digest = hashlib.sha256(f"{dense.dtype.str}{dense.shape}".encode())
    digest.update(dense.tobytes())
    return digest.hexdigest()


def write_arrays(path: Path, arrays: Mapping[str, Any]) -> None:
    """Write an NPZ file; complete or not at all."""
    with atomic_path(path) as temporary:
        np.savez_compressed(temporary, allow_pickle=False, **arrays)


def read_arrays(path: Path, names: Sequence[str]) -> dict[str, Any] | None:
    """Arrays of an earlier run; None if there are none, or they cannot all be read."""
    try:
        require_regular(path)
        with np.load(path, allow_pickle=False) as file:
            return {name: file[name] for name in names}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error):
        return None
