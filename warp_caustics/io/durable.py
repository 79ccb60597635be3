"""Files that appear whole, durable and checked, or not at all; each step can be made to fail by tests.

Order of one publication: temporary file (O_EXCL), write, fsync, close, for some
files read back and compare, rename, fsync of the folder. What survives a crash
or a power failure is then either the old state or the new one.
"""

import errno
import hashlib
import os
import re
import secrets
import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

from warp_caustics.errors import CausticsError, InputError, ResourceError

TEMPORARY_PREFIX = ".tmp-"
_TEMPORARY = re.compile(rf"{re.escape(TEMPORARY_PREFIX)}[0-9a-f]{{16}}(\.[^/]*)?\Z")

_WRITE_BYTES = 16 * 2**20
MACHINE_MENDS = {
    errno.ENOSPC: "free space",
    errno.EDQUOT: "free space or raise the quota",
    errno.EFBIG: "raise the limit of file sizes (ulimit -f)",
    errno.EIO: "the disk reports an error, look at it",
    errno.EMFILE: "close files or raise the limit of open files (ulimit -n)",
    errno.ENFILE: "close files",
    errno.ESTALE: "the network file system lost the file, look at it",
    errno.ENOMEM: "free memory",
}
"""What a machine has too little of, or is set too low, while it reads and writes; the mend."""
_CUT_SHORT = re.compile(r"\d+ requested and \d+ written")
_DENIED = (errno.EACCES, errno.EPERM, errno.EROFS)

T = TypeVar("T")


class SystemCalls:
    """Thin names for what :mod:`os` does, in one replaceable object: tests make each of them fail in turn."""

    def open(self, path: Path, flags: int) -> int:
        return os.open(path, flags | os.O_CLOEXEC, 0o666)

    def write(self, descriptor: int, data: memoryview) -> int:
        return os.write(descriptor, data)

    def read(self, descriptor: int, count: int) -> bytes:
        return os.read(descriptor, count)

    def fsync(self, descriptor: int) -> None:
        os.fsync(descriptor)

    def close(self, descriptor: int) -> None:
        os.close(descriptor)

    def replace(self, source: Path, target: Path) -> None:
        os.replace(source, target)

    def unlink(self, path: Path) -> None:
        os.unlink(path)

    def mkdir(self, path: Path) -> None:
        os.mkdir(path)


CALLS = SystemCalls()


class _Unreliable(OSError):
    """The bytes may not be on the disk, although writing them again may help."""


def publish(target: Path, data: bytes | memoryview, *, reread: bool = False) -> None:
    """Write a file so that it is complete and durable under its name, or absent.

    Args:
        target: final path; an existing file is replaced.
        data: content.
        reread: read the file back from the disk and compare before it gets its name.

    Raises:
        ResourceError: the disk is full or broken.
        InputError: the folder may not be written.
    """
    view = memoryview(data).cast("B")
    try:
        try:
            _publish_once(target, view, reread)
        except _Unreliable:
            # After a failed fsync the kernel marks the lost pages as clean: another fsync of the same file would
            # report success. Only a new file tells the truth.
            _publish_once(target, view, reread)
    except OSError as error:
        raise explained(error, target, len(view)) from error


def settle(temporary: Path, target: Path) -> None:
    """Give a file that somebody has written its name, durably.

    Raises:
        OSError: the disk is full or broken; ``target`` may be the old or the new file.
    """
    descriptor = restarted(lambda: CALLS.open(temporary, os.O_RDONLY))
    try:
        restarted(lambda: CALLS.fsync(descriptor))
    finally:
        _close(descriptor)
    restarted(lambda: CALLS.replace(temporary, target))
    sync_folder(target.parent)


def temporary_name(target: Path, suffix: str = "") -> Path:
    """A name beside a file's own that nobody else uses."""
    return target.with_name(f"{TEMPORARY_PREFIX}{secrets.token_hex(8)}{suffix}")


def is_temporary(name: str) -> bool:
    """Whether :func:`temporary_name` made a name; others that merely begin alike belong to somebody else."""
    return _TEMPORARY.match(name) is not None


def remove(path: Path) -> None:
    """Remove a file if it is there, durably."""
    try:
        with suppress(FileNotFoundError):
            CALLS.unlink(path)
        sync_folder(path.parent)
    except OSError as error:
        raise explained(error, path, 0) from error


def make_folder(path: Path) -> None:
    """Make a folder if it is missing, durably; its parent must exist."""
    try:
        try:
            restarted(lambda: CALLS.mkdir(path))
        except FileExistsError:
            if not path.is_dir():
                raise InputError(f"{str(path)!r} is a file; give a folder") from None
            return
        sync_folder(path.parent)
    except FileNotFoundError:
        raise InputError(f"folder {str(path.parent)!r} does not exist; create it first") from None
    except OSError as error:
        raise explained(error, path, 0) from error


def sweep(*folders: Path) -> None:
    """Remove what killed writers left. Call only where nobody else is writing."""
    for folder in folders:
        for entry in list(os.scandir(folder)) if folder.is_dir() else ():
            if is_temporary(entry.name) and entry.is_file(follow_symlinks=False):
                with suppress(FileNotFoundError):
                    os.unlink(entry.path)


def machine_mend(error: OSError) -> str | None:
    """What to do about what the machine lacks; None where something else failed.

    HDF5 and NumPy tell of a full disk, and of a write that was cut short, in words only, without the error's number.
    """
    if "No space left" in str(error):
        return MACHINE_MENDS[errno.ENOSPC]
    if _CUT_SHORT.search(str(error)):
        return f"{MACHINE_MENDS[errno.ENOSPC]} or {MACHINE_MENDS[errno.EFBIG]}"
    return MACHINE_MENDS.get(error.errno or 0)


def explained(error: OSError, path: Path, needed: int) -> Exception:
    """The error a person can act on."""
    text = f"cannot write {str(path)!r} ({error.strerror or error}"
    if error.errno in _DENIED:
        return InputError(f"{text}); choose a folder that this user may write")
    if isinstance(error, _Unreliable) or error.errno in MACHINE_MENDS:
        action = MACHINE_MENDS.get(error.errno or 0, "the disk is unreliable, look at it")
        return ResourceError(
            f"{text}; {needed:,} bytes needed, {_free_bytes(path):,} free); {action}, "
            "then run the same command again to resume"
        )
    return CausticsError(f"{text}); run the same command again to resume")


def _free_bytes(path: Path) -> int:
    try:
        return shutil.disk_usage(path.parent).free
    except OSError:
        return 0


def _publish_once(target: Path, view: memoryview, reread: bool) -> None:
    temporary = temporary_name(target)
    try:
        _write(temporary, view)
        if reread and not _holds(temporary, view):
            raise _Unreliable(errno.EIO, "the disk returns other bytes than were written")
        _rename(temporary, target, view)
    except BaseException:
        with suppress(OSError):
            os.unlink(temporary)
        raise
    try:
        sync_folder(target.parent)
    except OSError as error:
        if error.errno == errno.EIO:
            raise _Unreliable(error.errno, error.strerror) from error
        raise


def _write(temporary: Path, view: memoryview) -> None:
    calls = CALLS
    descriptor = restarted(lambda: calls.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL))
    try:
        while view:
            written = restarted(lambda part=view: calls.write(descriptor, part[:_WRITE_BYTES]))  # type: ignore[misc]
            if written == 0:
                raise OSError(errno.EIO, "the disk takes no bytes")
            view = view[written:]
        _unreliable_if_eio(lambda: restarted(lambda: calls.fsync(descriptor)))
    except BaseException:
        with suppress(OSError):
            os.close(descriptor)
        raise
    # Network file systems report a full quota here.
    _unreliable_if_eio(lambda: _close(descriptor))


def _close(descriptor: int) -> None:
    # Linux has closed the descriptor even where it reports an interruption, and the data are on the disk by now.
    with suppress(InterruptedError):
        CALLS.close(descriptor)


def _holds(path: Path, view: memoryview) -> bool:
    calls = CALLS
    digest = hashlib.sha256()
    descriptor = restarted(lambda: calls.open(path, os.O_RDONLY))
    try:
        # Without this the comparison would be with the page cache, not with the disk.
        if hasattr(os, "posix_fadvise"):
            os.posix_fadvise(descriptor, 0, 0, os.POSIX_FADV_DONTNEED)
        while part := restarted(lambda: calls.read(descriptor, _WRITE_BYTES)):
            digest.update(part)
    finally:
        _close(descriptor)
    return digest.digest() == hashlib.sha256(view).digest()


def _rename(temporary: Path, target: Path, view: memoryview) -> None:
    try:
        restarted(lambda: CALLS.replace(temporary, target))
    except OSError:
        # A network file system may lose the answer to a rename it has made.
        if os.path.lexists(temporary) or not target.is_file() or not _holds(target, view):
            raise


def sync_folder(folder: Path) -> None:
    """Make names that were given or taken in a folder last through a power failure."""
    descriptor = restarted(lambda: CALLS.open(folder, os.O_RDONLY))
    try:
        restarted(lambda: CALLS.fsync(descriptor))
    finally:
        _close(descriptor)


def restarted(call: Callable[[], T]) -> T:
    """The result of a system call that is made again when a signal interrupts it."""
    while True:
        try:
            return call()
        except InterruptedError:
            continue


def _unreliable_if_eio(call: Callable[[], None]) -> None:
    try:
        call()
    except OSError as error:
        if error.errno == errno.EIO:
            raise _Unreliable(error.errno, error.strerror) from error
        raise
