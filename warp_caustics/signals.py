"""Ctrl-C and SIGTERM: answered for a while, and then as before."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

Restore = Callable[[], None]


@contextmanager
def answered(answer: Callable[[int, Restore], None], *numbers: signal.Signals) -> Iterator[None]:
    """Inside, signals call a function, at any moment between two steps of the interpreter.

    Outside of the main thread nothing changes, for Python delivers signals there only.

    Args:
        answer: called with the signal's number and a function that puts all handlers back, so that a second signal
            does what it did before; may raise.
        numbers: of the signals.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before: dict[int, Any] = {}

    def restore() -> None:
        for number, handler in before.items():
            signal.signal(number, handler)

    def react(number: int, frame: FrameType | None) -> None:
        answer(number, restore)

    try:
        for number in numbers:
            before[number] = signal.getsignal(number)
            signal.signal(number, react)
        yield
    finally:
        restore()


@contextmanager
def deferred(*numbers: signal.Signals) -> Iterator[None]:
    """Inside, signals wait; those that came are raised at the end.

    For what must be done whole, such as starting a process and noting it down. A mask would not do: threads that do not
    block a signal receive it too, and Python's main thread answers.

    Args:
        numbers: of the signals.
    """
    arrived: list[int] = []
    try:
        with answered(lambda number, _restore: arrived.append(number), *numbers):
            yield
    finally:
        for number in arrived:
            signal.raise_signal(number)
