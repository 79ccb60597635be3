"""Threads that ask for the same kernels at once."""

import re
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

import warp_caustics
from warp_caustics.kernels.made_once import made_once


def test_kernels_are_made_by_one_thread_at_a_time_and_once():
    busy, most, made = [0], [0], []

    def noted(name):
        busy[0] += 1
        most[0] = max(most[0], busy[0])
        time.sleep(0.01)
        made.append(name)
        busy[0] -= 1
        return object()

    first = made_once(noted)

    @made_once
    def second(name):
        """Made of another."""
        return first(name), noted(name + " again")

    assert second.__doc__ == "Made of another."
    gate = threading.Barrier(8)

    def ask(number):
        gate.wait()
        return (first, second)[number % 2]("a" if number < 4 else "b")

    with ThreadPoolExecutor(8) as threads:
        found = list(threads.map(ask, range(8)))
    assert most[0] == 1 and sorted(made) == ["a", "a again", "b", "b again"]
    assert found[0] is found[2] is found[1][0] and found[4] is found[6] is found[5][0] and found[0] is not found[4]


def test_what_fails_is_tried_again():
    tries = []

    @made_once
    def fails_first():
        tries.append(1)
        if len(tries) == 1:
            raise RuntimeError("busy")
        return len(tries)

    with pytest.raises(RuntimeError, match="busy"):
        fails_first()
    assert fails_first() == fails_first() == 2


def test_all_kernels_that_are_kept_are_made_so():
    """functools.cache calls what it keeps in as many threads as ask for it at once."""
    files = [path for path in Path(warp_caustics.__file__).parent.rglob("*.py") if path.name != "made_once.py"]
    texts = {path.name: path.read_text(encoding="utf-8") for path in files}
    makers = {name: text for name, text in texts.items() if re.search(r"@wp\.(kernel|func)", text)}
    assert len(makers) > 20 and sum("@made_once" in text for text in makers.values()) > 20
    assert not [name for name, text in makers.items() if re.search(r"@(functools\.)?(lru_)?cache\b", text)]
