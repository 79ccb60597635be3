"""The device to compute on."""

import contextlib

from warp_caustics.native_words import native_words


def start_device(name: str) -> str:
    """Device to use, checked, with Warp running. A GPU is torch's current one from then on: graphs are recorded there.

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
    if device.startswith("cuda"):
        torch.cuda.set_device(device)
    # Warp's native code warns of a missing driver, whatever its log level; no news on a machine without a GPU.
    with contextlib.nullcontext() if has_cuda else native_words():
        wp.init()
    return device


def device_name(device: str) -> str:
    """What a device is, for records: the model of a GPU, or of the processor and its threads."""
    import torch

    if device.startswith("cuda"):
        return torch.cuda.get_device_name(device)
    model = "CPU"
    with contextlib.suppress(OSError), open("/proc/cpuinfo", encoding="utf-8", errors="replace") as file:
        model = next((line.partition(":")[2].strip() for line in file if line.startswith("model name")), model)
    return f"{model}, {torch.get_num_threads()} threads"
