"""When Python looks for unused objects that refer to each other: not while modules load, nor as a process ends.

Modules of torch, Warp and the rest make half a million objects, all of which stay. While they load Python walks
through them again and again, 1 s of a first result's CPU time, and more than once as it ends, another second.
"""

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def postponed() -> Iterator[None]:
    """Look for nothing until :func:`loaded` is called; the end of the block calls it."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled and not gc.isenabled():
            loaded()


def loaded() -> None:
    """What there is now stays as long as the process, and is walked through no more; what comes is.

    Only the first time: unused objects that were not found by then are kept as well.
    """
    if gc.get_freeze_count() == 0:
        gc.freeze()
    gc.enable()


def left_to_the_system() -> None:
    """As a process ends, the system takes its memory back; nothing is sought in it before.

    Nothing here relies on that search: files are closed where they are written.
    """
    gc.disable()
    gc.freeze()
