"""What the lowest and highest of some heights are, without waiting for a GPU that has more to do."""

import math
import time

import torch

NOT_YET = math.inf, -math.inf
"""Lowest and highest of nothing."""
AT_ONCE_S, PATIENCE_S, PAUSE_S = 1e-3, 10.0, 5e-5
"""For which the host looks without a pause; then with pauses; until it asks the GPU what is the matter."""


class Extremes:
    """Lowest and highest of some heights, which a GPU finds and copies to the host while this one goes on.

    One asks at a time: :meth:`forget`, then :meth:`begin`, then :meth:`read`. The host looks at its own memory until
    the copy is there: the launches may be part of a CUDA graph, in the middle of which nothing else can be waited for.

    Args:
        device: a GPU, which has the heights.
        dtype: of these.
    """

    def __init__(self, device: torch.device, dtype: torch.dtype):
        # Made once: memory that a GPU can write to takes the host longer than a simulation.
        self._pair = torch.zeros(2, dtype=dtype, pin_memory=device.type == "cuda")
        self._seen, self._device = self._pair.numpy(), device

    def find(self, heights: torch.Tensor) -> None:
        """Ask for those of heights of any shape; one that is not a number is both the lowest and the highest."""
        self.forget()
        self.begin(heights)

    def forget(self) -> None:
        """What was found before, which has been read."""
        self._seen[:] = NOT_YET

    def begin(self, heights: torch.Tensor) -> None:
        """The launches that this takes, which can be recorded; :meth:`forget` comes before each time that they run."""
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
                torch.cuda.synchronize(self._device)
                break
            time.sleep(0 if waited < AT_ONCE_S else PAUSE_S)
        lowest, highest = self._seen.tolist()
        return lowest, highest
