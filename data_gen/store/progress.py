"""What a build tells while it runs, and its summary."""

import time
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

_WINDOW = 32
"""Shards over which the rate is taken: long enough to be steady, short enough to follow changes."""


class Progress(NamedTuple):
    """State of a build.

    Attributes:
        done: finished samples, those of earlier runs included.
        total: samples of the data set.
        rate: samples per second lately; 0 before the first shard.
        eta_s: time left [s]; None while the rate is unknown.
    """

    done: int
    total: int
    rate: float
    eta_s: float | None


class BuildReport(NamedTuple):
    """What a build did.

    Attributes:
        shards_built: in this run.
        samples_built: in this run.
        bytes_written: size of the shards of this run.
        seconds: duration [s].
        notices: what went wrong and was mended.
    """

    shards_built: int
    samples_built: int
    bytes_written: int
    seconds: float
    notices: tuple[str, ...]


class Meter:
    """Counts samples and calls back."""

    def __init__(
        self,
        done: int,
        total: int,
        progress: Callable[[Progress], None] | None,
        notice: Callable[[str], None] | None,
    ) -> None:
        self._done, self._total, self._before = done, total, done
        self._progress, self._notice = progress, notice
        self._notices: list[str] = []
        self._shards = self._bytes = 0
        self._start = time.monotonic()
        self._recent = deque([(self._start, done)], maxlen=_WINDOW + 1)
        self._call()

    def begin(self) -> None:
        """Start the clock of the rate: workers are up."""
        self._recent = deque([(time.monotonic(), self._done)], maxlen=_WINDOW + 1)

    def add(self, samples: int, size: int) -> None:
        """A shard is published."""
        self._done += samples
        self._shards += 1
        self._bytes += size
        self._recent.append((time.monotonic(), self._done))
        self._call()

    def note(self, text: str) -> None:
        """Something went wrong and is being mended."""
        self._notices.append(text)
        if self._notice is not None:
            self._notice(text)

    def report(self) -> BuildReport:
        seconds = time.monotonic() - self._start
        return BuildReport(self._shards, self._done - self._before, self._bytes, seconds, tuple(self._notices))

    def _call(self) -> None:
        if self._progress is None:
            return
        (first, before), (last, now) = self._recent[0], self._recent[-1]
        rate = (now - before) / (last - first) if last > first else 0.0
        left = self._total - self._done
        self._progress(Progress(self._done, self._total, rate, left / rate if rate > 0 else None))
