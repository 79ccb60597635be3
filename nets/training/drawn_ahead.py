"""What the host draws for batches to come, in a thread of its own, while the device works on those before."""

from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Generic, TypeVar

import torch

Drawn = TypeVar("Drawn")


class DrawnAhead(Generic[Drawn]):
    """Draws batches by their sample numbers.

    Args:
        draw: draws a batch on the host; depends on the numbers alone.
    """

    def __init__(self, draw: Callable[[range], Drawn]):
        self._draw = draw
        self._pool = ThreadPoolExecutor(max_workers=1, thread_name_prefix="drawing")
        self._waiting: dict[range, Future[Drawn]] = {}

    def __call__(self, ids: range, following: Iterable[range] = ()) -> Drawn:
        """A batch, drawn before if it was named then.

        Args:
            ids: sample numbers.
            following: batches that will be asked for next.
        """
        found = self._waiting.pop(ids, None)
        drawn = found.result() if found is not None else self._draw(ids)
        for coming in following:
            if coming not in self._waiting:
                self._waiting[coming] = self._pool.submit(self._draw, coming)
        return drawn

    def close(self) -> None:
        """End the thread."""
        self._pool.shutdown(wait=True, cancel_futures=True)
        self._waiting.clear()


def sendable(tensor: torch.Tensor, device: torch.device) -> torch.Tensor:
    """The tensor in memory from which it reaches a device without anybody waiting."""
    return tensor.pin_memory() if device.type == "cuda" else tensor
