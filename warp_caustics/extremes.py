"""What the lowest and highest of some heights are, without waiting for a GPU that has more to do."""

import math
import time
from typing import Any

import torch
import warp as wp

from warp_caustics.kernels import dtype_of
from warp_caustics.kernels.runtime import start_warp

NOT_YET = math.inf, -math.inf
"""Lowest and highest of nothing."""
AT_ONCE_S, PATIENCE_S, PAUSE_S = 1e-3, 10.0, 5e-5
"""For which the host looks without a pause; then with pauses; until it asks the GPU what is the matter."""


class Extremes:
    """Lowest and highest of some heights, which a GPU finds and tells the host while it goes on.

    One asks at a time: :meth:`ask`, then launches that read the heights and find both, then :meth:`read`; or
    :meth:`find` and :meth:`read`. The host looks at its own memory until both are there: the launches may be part of a
    CUDA graph, in the middle of which nothing else can be waited for. A graph needs no copy of the heights either: it
    is told where they are, which is where they were before as a rule.

    Args:
        device: a GPU, which has the heights.
        dtype: of these.

    Attributes:
        where: address of the heights, for kernels, shape [1].
        here: lowest and highest so far, on the device, as integers in the same order, shape [2].
        told: the same where the host looks for them.
    """

    def __init__(self, device: torch.device, dtype: torch.dtype):
        start_warp()
        is_gpu = device.type == "cuda"
        # Made once: memory that a GPU can write to takes the host longer than a simulation.
        self._pair = torch.zeros(2, dtype=dtype, pin_memory=is_gpu)
        self._address = torch.zeros(1, dtype=torch.int64, device=device)
        bits = torch.tensor(NOT_YET, dtype=dtype).view(torch.int32 if dtype == torch.float32 else torch.int64)
        self._best = torch.where(bits < 0, bits ^ torch.iinfo(bits.dtype).max, bits).to(device)
        self._seen, self._asked, self._device = self._pair.numpy(), 0, device
        kind, reader = dtype_of(torch.finfo(dtype).bits), wp.device_from_torch(device)
        self.where: Any = wp.array(ptr=self._address.data_ptr(), shape=(1,), dtype=wp.uint64, device=reader)
        self.told: Any = wp.array(ptr=self._pair.data_ptr(), shape=(2,), dtype=kind, device=reader)
        self.here = wp.from_torch(self._best)

    def ask(self, heights: torch.Tensor) -> None:
        """Whose extremes the next launches shall tell; contiguous, and kept until :meth:`read` returns."""
        self._seen[:] = NOT_YET
        asked = heights.data_ptr()
        if asked != self._asked:
            self._address.fill_(asked)
            self._asked = asked

    def find(self, heights: torch.Tensor) -> None:
        """Ask for those of heights of any shape; one that is not a number is both the lowest and the highest."""
        self._seen[:] = NOT_YET
        self._pair.copy_(torch.stack(torch.aminmax(heights.detach())), non_blocking=True)

    def read(self) -> tuple[float, float]:
        """Both, as soon as they are there.

        Raises:
            RuntimeError: the GPU has failed.
        """
        began = time.perf_counter()
        # Half of a copy is above the other half still, or is of heights that are refused whatever the other is.
        while self._seen[0] > self._seen[1]:
            waited = time.perf_counter() - began
            if waited > PATIENCE_S:
                self._asked = 0  # who knows what the GPU was told
                torch.cuda.synchronize(self._device)
                break
            time.sleep(0 if waited < AT_ONCE_S else PAUSE_S)
        lowest, highest = self._seen.tolist()
        return lowest, highest
