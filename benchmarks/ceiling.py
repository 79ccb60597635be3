"""The GPU's limit for what splatting is made of: float32 atomic additions to a 3 MiB image."""

import statistics
from collections.abc import Callable
from typing import Any, no_type_check

import torch
import warp as wp

UPDATES_PER_THREAD = 64
THREADS = 2**22


@no_type_check
@wp.kernel(enable_backward=False)
def add_coalesced(values: wp.array[float]):
    """Neighbouring threads add to neighbouring pixels."""
    tid = wp.tid()
    for k in range(UPDATES_PER_THREAD):
        wp.atomic_add(values, (tid + k * 7919) % values.shape[0], 1.0)


@no_type_check
@wp.kernel(enable_backward=False)
def add_scattered(values: wp.array[float]):
    """Every thread adds somewhere else."""
    tid = wp.tid()
    state = wp.rand_init(1, tid)
    for _ in range(UPDATES_PER_THREAD):
        wp.atomic_add(values, wp.randi(state, 0, values.shape[0]), 1.0)


def atomic_ceilings(device: str, seconds: Callable[[Callable[[], object], str, int], list[float]]) -> dict[str, float]:
    """Atomic additions per second, coalesced and scattered, over 3 x 512 x 512 pixels."""
    values = wp.zeros(3 * 512 * 512, dtype=float, device=device)

    def rate(kernel: Any) -> float:
        times = seconds(lambda: wp.launch(kernel, dim=THREADS, inputs=[values], device=device), device, 10)
        return THREADS * UPDATES_PER_THREAD / statistics.median(times)

    torch.cuda.synchronize()
    return {"coalesced": rate(add_coalesced), "scattered": rate(add_scattered)}
