"""One builder per folder.

Two things keep a second builder out: flock, which the kernel gives back the
moment its holder dies, and a lease in the same file for builders on other
hosts, to whom flock may mean nothing. The holder touches the file every few
seconds; a lease that nobody touched for the grace time is taken over. Data do
not depend on this: two builders write the same bytes, the lock only saves work.

The package filelock has both kinds, but not together. Its native lock knows no
other hosts and no name of the holder. Its SoftFileLease makes a build that is
resumed watch a dead host's lease for the whole grace time, where the age of the
file tells at once, and recognises the dead of its own host by their process
number alone, which means nothing between containers.
"""

import errno
import fcntl
import json
import os
import secrets
import socket
import stat
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from warp_caustics.errors import InputError, MismatchError
from warp_caustics.io import durable
from warp_caustics.io.durable import TEMPORARY_PREFIX, explained, restarted

BEAT_S = 5.0
GRACE_S = 60.0
"""Longer than network file systems keep attributes (up to 60 s only where configured so), and many beats."""

AHEAD_S = 10.0
"""By which a sign of life may be dated ahead: two beats, for clocks that nearly agree."""

_UNSUPPORTED = (errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS)
_SETTLE_S = 0.2
_LEASE = b'{"host"'
"""How the content of a lock file begins."""


class BuildLock:
    """Context in which nobody else builds.

    Args:
        path: the lock file; stays behind, empty.
        beat_s: time between signs of life [s].
        grace_s: a lease without a sign of life for this long is dead [s].

    Raises:
        MismatchError: on entering; names host and process that build.
    """

    def __init__(self, path: Path, *, beat_s: float = BEAT_S, grace_s: float = GRACE_S) -> None:
        self._path, self._beat_s, self._grace_s = path, beat_s, grace_s
        self._nonce, self._host = secrets.token_hex(8), socket.gethostname()
        self._stopped = threading.Event()
        self._descriptor = -1

    def __enter__(self) -> "BuildLock":
        try:
            # Through a link the lease would be written over somebody else's file.
            flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK
            try:
                self._descriptor = restarted(lambda: durable.CALLS.open(self._path, flags))
            except OSError as error:
                if error.errno in (errno.ELOOP, errno.EISDIR, errno.ENXIO):
                    raise self._foreign() from error
                raise
            try:
                self._check_kind()
                self._acquire()
            except BaseException:
                os.close(self._descriptor)
                raise
        except OSError as error:
            raise explained(error, self._path, 0) from error
        self._thread = threading.Thread(target=self._beat, name="lease", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *exception: Any) -> None:
        self._stopped.set()
        self._thread.join()
        with suppress(OSError):
            if self._is_mine():
                os.ftruncate(self._descriptor, 0)
        os.close(self._descriptor)

    @property
    def lost(self) -> bool:
        """Another host has taken over, while this process was suspended or cut off."""
        try:
            return not self._is_mine()
        except OSError:
            return False

    def check(self) -> None:
        """Refuse to go on after another host has taken over.

        Raises:
            MismatchError: names who.
        """
        if self.lost:
            raise MismatchError(f"{self._owner()} took over while this process was suspended; leave it the folder")

    def _acquire(self) -> None:
        locked = True
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self._wait_for_name()
            raise self._refusal("wait for it or stop it") from None
        except OSError as error:
            if error.errno not in _UNSUPPORTED:
                raise
            locked = False
        lease = self._lease()
        # A lease of this host whose flock is free: its process is dead.
        if lease is not None and not (locked and lease.get("host") == self._host):
            age = self._age_s()
            if age < -AHEAD_S:
                # A dead builder's date would stay ahead for as long as its clock was wrong; a live one sets it again.
                os.utime(self._path)
                raise self._refusal(
                    f"its last sign of life is dated {-age / 3600:,.0f} h ahead (a clock that is wrong); that was set "
                    f"right: wait for it; if it is dead, try again in {self._grace_s:.0f} s"
                )
            if age < self._grace_s:
                rest = self._grace_s - age
                raise self._refusal(f"wait for it; if it is dead, try again in {rest:.0f} s")
        data = json.dumps({"host": self._host, "pid": os.getpid(), "nonce": self._nonce}).encode()
        os.ftruncate(self._descriptor, 0)
        os.lseek(self._descriptor, 0, os.SEEK_SET)
        restarted(lambda: durable.CALLS.write(self._descriptor, memoryview(data)))
        if lease is not None or not locked:
            # Two may have found the same dead lease; the one that wrote last stays.
            time.sleep(_SETTLE_S)
        if not self._is_mine():
            raise self._refusal("wait for it or stop it")

    def _check_kind(self) -> None:
        """Refuse a file that no builder wrote: its content would be lost."""
        if not stat.S_ISREG(os.fstat(self._descriptor).st_mode):
            raise self._foreign()
        data = os.pread(self._descriptor, 4096, 0).strip(b"\0")
        # A lease may be cut off.
        if data and not (data.startswith(_LEASE) or _LEASE.startswith(data)):
            raise self._foreign()

    def _foreign(self) -> InputError:
        return InputError(f"{str(self._path)!r} is in the place of the lock, but no lock; move it away")

    def _refusal(self, action: str) -> MismatchError:
        return MismatchError(f"{str(self._path.parent)!r} is being built by {self._owner()}; {action}")

    def _owner(self) -> str:
        lease = self._lease() or {}
        return f"process {lease.get('pid', 'unknown')} on {lease.get('host', 'an unknown host')}"

    def _wait_for_name(self) -> None:
        # The holder may have the lock for a moment before it has written its name.
        deadline = time.monotonic() + 1.0
        while not (self._lease() or {}).get("pid") and time.monotonic() < deadline:
            time.sleep(0.02)

    def _lease(self) -> dict[str, Any] | None:
        """Content of the lease; None where it is free, {} where it cannot be read."""
        data = os.pread(self._descriptor, 4096, 0)
        if not data.strip(b"\0"):
            return None
        try:
            lease = json.loads(data)
        except ValueError:
            return {}
        return lease if isinstance(lease, dict) else {}

    def _is_mine(self) -> bool:
        return (self._lease() or {}).get("nonce") == self._nonce

    def _age_s(self) -> float:
        """Time since the last sign of life [s].

        Both times come from the clock of the file system's host: the clocks of the builders may disagree.
        """
        probe = self._path.with_name(f"{TEMPORARY_PREFIX}{self._nonce}")
        probe.touch()
        try:
            return probe.stat().st_mtime - os.stat(self._path).st_mtime
        finally:
            probe.unlink(missing_ok=True)

    def _beat(self) -> None:
        while not self._stopped.wait(self._beat_s):
            with suppress(OSError):
                if self._is_mine():
                    os.utime(self._descriptor)
