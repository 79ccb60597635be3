"""Kernels that are made when they are first asked for, by one thread at a time.

Chunks of photons are simulated by several threads, and the first of each ask for the same kernels at once. Warp reads
the source of a kernel with ``ast.parse``, which two threads must not do together in Python 3.11: now and then one ends
with "SystemError: AST constructor recursion depth mismatch" (CPython issue 106905).
"""

import threading
from collections.abc import Callable
from functools import cache, wraps
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")

_LOCK = threading.RLock()


def made_once(make: Callable[P, T]) -> Callable[P, T]:
    """``functools.cache`` that calls ``make`` in one thread at a time, and once for equal arguments.

    Args:
        make: makes kernels; may call others that are made once.
    """
    kept = cache(make)

    @wraps(make)
    def made(*args: P.args, **kwargs: P.kwargs) -> T:
        with _LOCK:
            return kept(*args, **kwargs)  # type: ignore[arg-type]

    return made
