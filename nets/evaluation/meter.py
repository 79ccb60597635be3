"""How long a method took, and how much memory."""

import os
import threading
import time
from pathlib import Path
from types import TracebackType

import torch

INTERVAL_S = 0.02

_STATM = Path("/proc/self/statm")
_PAGE = os.sysconf("SC_PAGE_SIZE")


class Meter:
    """Wall time and peak memory of a block.

    On a CPU the largest resident set of the whole process, libraries and all, sampled every 20 ms: what a machine
    must have. On a GPU what the block allocated there beyond what was in use before.

    Args:
        device: where the block computes.
    """

    def __init__(self, device: torch.device):
        self.device, self.seconds, self.peak_bytes = device, 0.0, 0
        self._stop = threading.Event()
        self._sampler: threading.Thread | None = None

    def __enter__(self) -> "Meter":
        if self.device.type == "cuda":
            torch.cuda.synchronize(self.device)
            torch.cuda.reset_peak_memory_stats(self.device)
            self._before = torch.cuda.memory_allocated(self.device)
        else:
            self._sampler = threading.Thread(target=self._sample, daemon=True)
            self._sampler.start()
        self._started = time.perf_counter()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._sampler is not None:
            self.seconds = time.perf_counter() - self._started
            self._stop.set()
            self._sampler.join()
            self.peak_bytes = max(self.peak_bytes, resident_bytes())
        elif error is None:
            # After an error of the device this would raise another.
            torch.cuda.synchronize(self.device)
            self.seconds = time.perf_counter() - self._started
            self.peak_bytes = torch.cuda.max_memory_allocated(self.device) - self._before

    def _sample(self) -> None:
        while not self._stop.is_set():
            self.peak_bytes = max(self.peak_bytes, resident_bytes())
            self._stop.wait(INTERVAL_S)


def resident_bytes() -> int:
    """Memory of this process that is in use now [bytes]."""
    return int(_STATM.read_text(encoding="ascii").split()[1]) * _PAGE
