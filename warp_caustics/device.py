"""The device to compute on."""

import contextlib
import os
import sys
from collections.abc import Iterator


def start_device(name: str) -> str:
    """Device to use, checked, with Warp running.

    Args:
        name: cpu, cuda, cuda:N, or auto, which takes cuda where there is one.

    Raises:
        InputError: not a device name.
        ResourceError: the machine has no such device.
    """
    import torch
    import warp as wp

    from warp_caustics.simulator import usable_device

    has_cuda = torch.cuda.is_available()
    if name == "auto":
        name = "cuda" if has_cuda else "cpu"
    device = str(usable_device(name))
    # Warp's native code warns of a missing driver, whatever its log level; no news on a machine without a GPU.
    with contextlib.nullcontext() if has_cuda else _stderr_off():
        wp.init()
    return device


@contextlib.contextmanager
def _stderr_off() -> Iterator[None]:
    sys.stderr.flush()
    saved, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)
        os.close(nowhere)
