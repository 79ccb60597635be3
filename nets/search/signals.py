"""Ctrl-C and SIGTERM at moments that suit: never in the middle of a transaction.

An exception out of a signal handler can leave a query of SQLite open; its lock
then holds up every later commit, of this process too, until the time-out.
"""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from warp_caustics.signals import Restore, answered


class StoppedError(KeyboardInterrupt):
    """A signal asked for the end; a KeyboardInterrupt, because Optuna takes that for an order.

    Attributes:
        reason: ``interrupted`` or ``terminated``.
    """

    def __init__(self, reason: str):
        super().__init__(reason)
        self.reason = reason


_asked: str | None = None


def check_stopped() -> None:
    """A moment that suits.

    Raises:
        StoppedError: a signal arrived since :func:`signals_wait` was entered.
    """
    if _asked is not None:
        raise StoppedError(_asked)


@contextmanager
def signals_wait() -> Iterator[None]:
    """Inside, a signal waits for :func:`check_stopped`; a second one is a KeyboardInterrupt at once."""
    global _asked
    if threading.current_thread() is not threading.main_thread():
        yield  # of the flag, too, the main thread is the owner
        return

    def note(number: int, restore: Restore) -> None:
        global _asked
        if _asked is not None:
            raise KeyboardInterrupt(_asked)
        _asked = "terminated" if number == signal.SIGTERM else "interrupted"

    _asked = None
    try:
        with answered(note, signal.SIGINT, signal.SIGTERM):
            yield
    finally:
        _asked = None
