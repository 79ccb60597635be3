"""Opening files: regular ones only, the one place where that is checked.

Opening a pipe waits for somebody who writes, reading a device may never end.
Files are therefore opened without waiting and looked at before a byte is read.
"""

import errno
import os
import stat
from io import BufferedReader

PathLike = str | os.PathLike[str]

MAX_RECORD_BYTES = 256_000_000
"""Most that is read of a file that is taken into memory as it is: a record, a manifest, a log."""

_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
    (stat.S_ISSOCK, "a socket"),
)


class IrregularFileError(OSError):
    """What a path names is there, but no regular file, or larger than is read."""


def kind_of(mode: int) -> str | None:
    """What a file of this mode is, ``a pipe`` for one; None for a regular file."""
    if stat.S_ISREG(mode):
        return None
    return next((name for test, name in _KINDS if test(mode)), "no regular file")


def require_regular(path: PathLike) -> os.stat_result:
    """Status of a regular file, for a library that will open it by its path.

    Raises:
        IrregularFileError: a folder, a pipe, a device or a socket.
        OSError: missing or out of reach.
    """
    info = os.stat(path)
    kind = kind_of(info.st_mode)
    if kind is not None:
        raise IrregularFileError(errno.EINVAL, f"it is {kind}, no file", os.fspath(path))
    return info


def open_regular(path: PathLike) -> BufferedReader:
    """Open a regular file for reading its bytes; nothing else is waited for.

    Raises:
        IrregularFileError: a folder, a pipe, a device or a socket.
        OSError: missing or unreadable.
    """
    require_regular(path)
    # It may have become a pipe since: opening that must not wait, and it is looked at once more.
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        kind = kind_of(os.fstat(descriptor).st_mode)
        if kind is not None:
            raise IrregularFileError(errno.EINVAL, f"it is {kind}, no file", os.fspath(path))
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def read_regular(path: PathLike, max_bytes: int = MAX_RECORD_BYTES) -> bytes:
    """Content of a regular file.

    Raises:
        IrregularFileError: no regular file, or more than ``max_bytes``.
        OSError: missing or unreadable.
    """
    with open_regular(path) as file:
        content = file.read(max_bytes + 1)
    if len(content) > max_bytes:
        raise IrregularFileError(errno.EFBIG, f"it has more than {max_bytes:,} bytes", os.fspath(path))
    return content
