"""Time in total and in the making of batches."""

import time
from collections.abc import Iterator
from contextlib import contextmanager

import torch


class Stopwatch:
    """Share of the time that a part of each step takes, read now and then.

    On a GPU the part is timed by events on the stream, which hold nothing up.

    Args:
        device: where the work is done.
    """

    def __init__(self, device: torch.device):
        self.is_cuda = device.type == "cuda"
        self._events: list[tuple[torch.cuda.Event, torch.cuda.Event]] = []
        self._part_s = 0.0
        self._start_s = time.perf_counter()

    @contextmanager
    def part(self) -> Iterator[None]:
        """Times the block."""
        if self.is_cuda:
            first, last = torch.cuda.Event(enable_timing=True), torch.cuda.Event(enable_timing=True)
            first.record()
            yield
            last.record()
            self._events.append((first, last))
            return
        start = time.perf_counter()
        yield
        self._part_s += time.perf_counter() - start

    def read(self) -> tuple[float, float]:
        """Seconds, and the share of the part in them, since the last reading; waits for the device."""
        part_s = self._part_s
        if self._events:
            self._events[-1][1].synchronize()
            part_s += sum(first.elapsed_time(last) for first, last in self._events) * 1e-3
        now = time.perf_counter()
        seconds = max(now - self._start_s, 1e-9)
        self._events.clear()
        self._part_s, self._start_s = 0.0, now
        return seconds, min(1.0, part_s / seconds)
