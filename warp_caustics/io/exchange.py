"""A folder takes the place of another in one step, where the file system can; in two that can be finished elsewhere."""

import ctypes
import errno
import os
from pathlib import Path

from warp_caustics.io.durable import sync_folder

_AT_FDCWD, _RENAME_EXCHANGE = -100, 2
_UNSUPPORTED = (errno.ENOSYS, errno.EINVAL, errno.EOPNOTSUPP)


def exchange(one: Path, other: Path) -> bool:
    """Swap two names of one file system atomically; False where kernel or file system cannot.

    Raises:
        OSError: one of them is missing, or may not be renamed.
    """
    call = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    if call is None:
        return False
    if call(_AT_FDCWD, os.fsencode(one), _AT_FDCWD, os.fsencode(other), _RENAME_EXCHANGE) == 0:
        return True
    code = ctypes.get_errno()
    if code in _UNSUPPORTED:
        return False
    raise OSError(code, os.strerror(code), str(other))


def old_name(new: Path) -> Path:
    """Where the folder that ``new`` replaces steps aside, if the two cannot be exchanged."""
    return new.with_name(f"{new.name}.old")


def publish_folder(new: Path, target: Path) -> Path | None:
    """Give a folder its name, in place of one that has it; durable when this returns.

    A kill leaves either folder under the name ``target``; only where names cannot be exchanged there is a moment in
    which both are hidden, and :func:`finish_publication` ends it.

    Returns:
        Where the former content is now, None if there was none.

    Raises:
        OSError: the name was taken or could not be changed; the former content has its name.
    """
    former: Path | None = None
    if not os.path.lexists(target):
        os.rename(new, target)
    elif exchange(new, target):
        former = new
    else:
        former = old_name(new)
        os.rename(target, former)
        try:
            os.rename(new, target)
        except BaseException:
            os.rename(former, target)
            raise
    sync_folder(target.parent)
    return former


def finish_publication(new: Path, target: Path) -> Path | None:
    """End what :func:`publish_folder` had begun when it was killed; returns the folder that is left over, if any."""
    former = old_name(new)
    if former.is_dir():
        if not os.path.lexists(target):
            os.rename(new if new.is_dir() else former, target)
            sync_folder(target.parent)
        return former if former.is_dir() else None
    return new if new.is_dir() else None
