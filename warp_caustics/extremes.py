"""What the lowest and highest of some heights are, without waiting for a GPU that has more to do."""

import torch


class Extremes:
    """Lowest and highest of some heights, which a GPU finds and copies to the host while this one goes on.

    One asks at a time.

    Args:
        device: a GPU, which has the heights.
        dtype: of these.
    """

    def __init__(self, device: torch.device, dtype: torch.dtype):
        # Made once: memory that a GPU can write to takes the host longer than a simulation.
        self._pair = torch.zeros(2, dtype=dtype, pin_memory=True)
        self._device, self._is_there = device, torch.cuda.Event()

    def find(self, heights: torch.Tensor) -> None:
        """Ask for those of heights of any shape; one that is not a number is both the lowest and the highest."""
        self.begin(heights)
        self.mark()

    def begin(self, heights: torch.Tensor) -> None:
        """The launches that this takes, which can be recorded; :meth:`mark` follows whenever they were begun."""
        self._pair.copy_(torch.stack(torch.aminmax(heights.detach())), non_blocking=True)

    def mark(self) -> None:
        """Remember that those asked for are there when the GPU has come so far."""
        self._is_there.record(torch.cuda.current_stream(self._device))

    def read(self) -> tuple[float, float]:
        """Both, as soon as they are there."""
        self._is_there.synchronize()
        lowest, highest = self._pair.tolist()
        return lowest, highest
