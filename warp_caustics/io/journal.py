"""One writer for each target, and what the last one left unfinished.

A hidden file beside the target is locked by its writer and holds a line of JSON
that tells what the writer is doing. The kernel gives the lock back when its
holder dies; the line stays, and the next writer of that target ends or undoes
what it tells of. Not handled: writers on several hosts where the file system
does not share flock.
"""

import errno
import fcntl
import hashlib
import json
import os
import socket
import stat
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from warp_caustics.errors import InputError, MismatchError
from warp_caustics.io.durable import explained

_UNSUPPORTED = (errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS)
_MOST_BYTES = 2**20


def journal_path(target: Path) -> Path:
    """The hidden file of a target; short whatever the target is called."""
    return target.with_name(f".nsfc-{hashlib.sha256(os.fsencode(target.name)).hexdigest()[:16]}.lock")


class Journal:
    """What the writer of a target is doing.

    Attributes:
        left: what the writer before had noted when it died; empty if it ended well.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        found = _content(descriptor) or {}
        # Whoever dies while it ends another's work leaves that to the next.
        self.left: dict[str, Any] = found.get("before") or found

    def note(self, record: Mapping[str, Any]) -> None:
        """Replace what stands in the journal."""
        line = json.dumps({"host": socket.gethostname(), "pid": os.getpid(), **record}) + "\n"
        # Readers take the first line: a kill before the file is cut leaves the new one complete.
        os.pwrite(self._descriptor, line.encode(), 0)
        os.ftruncate(self._descriptor, len(line))
        os.fsync(self._descriptor)


@contextmanager
def only_writer(path: Path, target: Path, *, keep: bool = False) -> Iterator[Journal]:
    """Context in which nobody else writes a target.

    Args:
        path: of the lock file; made if it is missing.
        target: for messages.
        keep: leave the file behind.

    Raises:
        MismatchError: somebody writes it; names host and process.
        InputError: the file is of somebody else, or cannot be made.
    """
    descriptor = _locked(path, target)
    try:
        journal = Journal(descriptor)
        try:
            journal.note({"before": journal.left} if journal.left else {})
        except OSError as error:
            # What the last writer noted must stay; a file that says nothing need not.
            if not journal.left and not keep:
                with suppress(FileNotFoundError):
                    os.unlink(path)
            raise explained(error, path, 0) from error
        try:
            yield journal
        finally:
            if keep:
                os.ftruncate(descriptor, 0)
            else:
                with suppress(FileNotFoundError):
                    os.unlink(path)
    finally:
        os.close(descriptor)


def _locked(path: Path, target: Path) -> int:
    while True:
        try:
            # A link would have the lock, and what is written to it, in a file of somebody else.
            flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
            descriptor = os.open(path, flags, 0o666)
        except OSError as error:
            if error.errno in (errno.ELOOP, errno.EISDIR, errno.ENXIO):
                raise _foreign(path) from error
            raise explained(error, path, 0) from error
        try:
            if not stat.S_ISREG(os.fstat(descriptor).st_mode):
                raise _foreign(path)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise _refusal(target, descriptor) from None
            except OSError as error:
                if error.errno not in _UNSUPPORTED:
                    raise explained(error, path, 0) from error
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(descriptor), os.lstat(path)):
                    if os.fstat(descriptor).st_size and _content(descriptor) is None:
                        raise _foreign(path)
                    return descriptor
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)  # its holder removed it meanwhile


def _content(descriptor: int) -> dict[str, Any] | None:
    line = os.pread(descriptor, _MOST_BYTES, 0).split(b"\n")[0]
    try:
        record = json.loads(line)
    except ValueError:
        return None
    return record if isinstance(record, dict) and "pid" in record else None


def _foreign(path: Path) -> InputError:
    return InputError(f"{str(path)!r} is in the place of a lock and was not made by nsfc; move it away")


def _refusal(target: Path, descriptor: int) -> MismatchError:
    holder = _content(descriptor) or {}
    who = f"process {holder.get('pid', 'unknown')} on {holder.get('host', 'this host')}"
    return MismatchError(f"{str(target)!r} is being written by {who}; wait for it, or name another folder")
