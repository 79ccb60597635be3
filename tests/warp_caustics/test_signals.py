"""Signals are answered for a while, and then as before."""

import os
import signal
import threading
import time

import pytest

from warp_caustics.signals import answered, deferred


def test_signals_call_the_answer_and_then_what_they_did_before():
    before = signal.signal(signal.SIGTERM, lambda number, frame: seen.append("before"))
    seen = []
    try:
        with answered(lambda number, restore: seen.append(number), signal.SIGTERM, signal.SIGINT):
            os.kill(os.getpid(), signal.SIGTERM)
            os.kill(os.getpid(), signal.SIGINT)
        os.kill(os.getpid(), signal.SIGTERM)
    finally:
        signal.signal(signal.SIGTERM, before)
    assert seen == [signal.SIGTERM, signal.SIGINT, "before"]


def test_second_signal_does_what_it_did_before_where_the_answer_says_so():
    def once(number, restore):
        restore()
        seen.append(number)

    seen = []
    with answered(once, signal.SIGINT, signal.SIGTERM):
        os.kill(os.getpid(), signal.SIGTERM)
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
    assert seen == [signal.SIGTERM]


def test_answer_that_raises_leaves_the_handlers_as_they_were():
    def stop(number, restore):
        raise SystemExit(143)

    handler = signal.getsignal(signal.SIGTERM)
    with pytest.raises(SystemExit), answered(stop, signal.SIGTERM):
        os.kill(os.getpid(), signal.SIGTERM)
    assert signal.getsignal(signal.SIGTERM) is handler


def test_nothing_changes_in_other_threads():
    handlers = []

    def work():
        with answered(lambda number, restore: None, signal.SIGTERM):
            handlers.append(signal.getsignal(signal.SIGTERM))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert handlers == [signal.getsignal(signal.SIGTERM)]


def test_a_deferred_signal_comes_at_the_end():
    done = []
    with pytest.raises(KeyboardInterrupt), deferred(signal.SIGINT):
        signal.raise_signal(signal.SIGINT)
        done.append("started")
        done.append("noted")
    assert done == ["started", "noted"]
    with deferred(signal.SIGINT):
        pass
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_deferred_signal_of_another_thread_waits_too():
    """A mask of the main thread would not keep it: the process gets it in a thread that has none."""
    done = []
    with pytest.raises(KeyboardInterrupt), deferred(signal.SIGINT):
        thread = threading.Thread(target=os.kill, args=(os.getpid(), signal.SIGINT))
        thread.start()
        thread.join()
        time.sleep(0.05)
        done.append("whole")
    assert done == ["whole"]
