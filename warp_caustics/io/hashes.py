"""Hashes of files: which file a record speaks of."""

import hashlib

from warp_caustics.io.atomic import PathLike


def file_sha256(path: PathLike) -> str:
    """SHA-256 of a file's content, in hexadecimal; the file may be larger than the memory.

    Raises:
        OSError: missing or unreadable.
    """
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
