"""Sums over chunks of photons, on one GPU stream or on all cores of a CPU."""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any, TypeVar

import torch
import warp as wp

from warp_caustics.photons import Chunk, PhotonPlan

Item = TypeVar("Item")
Result = TypeVar("Result")

CHUNK_BYTES = {"cpu": 64 * 2**20, "cuda": 2**30}
"""Arrays per photon held at a time."""

CPU_SLOTS = 8
"""Private sums on the CPU; more would use more cores, each costs an image of memory and one addition."""

MIN_CHUNK_PHOTONS = 2048
"""Smaller CPU chunks would cost more to start than to compute."""


@cache
def _thread_pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max_workers=torch.get_num_threads(), thread_name_prefix="caustics")


def sum_over_chunks(
    plan: PhotonPlan,
    bytes_per_photon: int,
    shape: tuple[int, ...],
    dtype: torch.dtype,
    device: torch.device,
    add: Callable[[torch.Tensor, Chunk], None],
) -> torch.Tensor:
    """Sum of what ``add(total, chunk)`` adds to zeros for every chunk of photons.

    A CPU launch of Warp runs on one core, so chunks go to a fixed number of
    slots with a private sum each, and slots to threads. The slots are added in
    order: the result does not depend on the number of cores.
    """
    limit = max(1, CHUNK_BYTES[device.type] // bytes_per_photon)
    if device.type == "cuda":
        with warp_stream(device):
            total = torch.zeros(shape, dtype=dtype, device=device)
            for chunk in plan.chunks(limit):
                add(total, chunk)
            return total
    share = max(MIN_CHUNK_PHOTONS, -(-plan.count // CPU_SLOTS))
    chunks = list(plan.chunks(min(limit, share)))
    slots = [chunks[k::CPU_SLOTS] for k in range(min(CPU_SLOTS, len(chunks)))]

    def fill(slot: list[Chunk]) -> torch.Tensor:
        total = torch.zeros(shape, dtype=dtype)
        for chunk in slot:
            add(total, chunk)
        return total

    parts = on_all_cores(fill, slots)
    total = next(parts)
    for part in parts:
        total += part
    return total


def on_all_cores(work: Callable[[Item], Result], items: Sequence[Item]) -> Iterator[Result]:
    """What ``work`` returns for each item, in order, without gradients; done on all cores of the CPU.

    With one thread of torch's it is done here: to hand an item to another and wait takes longer than a small launch.
    """

    def without_gradients(item: Item) -> Result:
        # torch's no_grad is per thread.
        with torch.no_grad():
            return work(item)

    if len(items) > 1 and torch.get_num_threads() > 1:
        return _thread_pool().map(without_gradients, items)
    return map(without_gradients, items)


def warp_stream(device: torch.device) -> contextlib.AbstractContextManager[Any]:
    """Makes Warp launch on torch's current stream, so that both see each other's results in order."""
    if device.type != "cuda":
        return contextlib.nullcontext()
    return wp.ScopedStream(wp.stream_from_torch(torch.cuda.current_stream(device)), sync_enter=False)


def warp_array(tensor: torch.Tensor) -> Any:
    """Warp's view of a tensor; detached, because Warp would allocate .grad for tensors that require it."""
    return wp.from_torch(tensor.detach(), requires_grad=False, return_ctype=True)
