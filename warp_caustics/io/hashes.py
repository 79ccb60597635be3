"""Hashes of files: which file a record speaks of."""

import hashlib

from warp_caustics.io.regular import PathLike, open_regular


def file_sha256(path: PathLike) -> str:
    """SHA-256 of a regular file's content, in hexadecimal; the file may be larger than the memory.

    Raises:
        OSError: missing, no regular file or unreadable.
    """
    with open_regular(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
