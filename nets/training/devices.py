"""A training and its devices: processes on them, mixed precision, and time where work is queued."""

import contextlib
import logging
import time
import warnings
from collections.abc import Iterator
from typing import Any

import torch

from nets.training.config import Precision

_DTYPES = {"bf16": torch.bfloat16, "16": torch.float16}


class OneProcess:
    """A training in this process alone, with the methods of Lightning's Fabric that it uses and without its loading.

    That takes 3 s of every start, for there is nothing to launch, to send or to average.

    Args:
        device: where the training is.
    """

    world_size, global_rank, is_global_zero = 1, 0, True

    def __init__(self, device: torch.device):
        self.device = device

    def setup_module(self, module: Any) -> Any:
        """The module itself, on the device."""
        return module.to(self.device)

    def no_backward_sync(self, module: Any, enabled: bool = True) -> contextlib.AbstractContextManager[None]:
        """Nothing is synchronised."""
        return contextlib.nullcontext()

    def backward(self, loss: torch.Tensor) -> None:
        """Gradients of all parameters."""
        loss.backward()

    def broadcast(self, value: Any) -> Any:
        """What the first process has, which is this one."""
        return value

    def all_reduce(self, value: torch.Tensor, reduce_op: str = "mean") -> torch.Tensor:
        """The mean or sum over processes, of one."""
        return value


def launched(device: str, devices: int) -> Any:
    """The processes of a training, running: this one, and for several devices one more each.

    Args:
        device: ``"cpu"``, ``"cuda"`` or ``"cuda:N"``.
        devices: how many; above 1 the networks are kept equal by DDP, and a Lightning Fabric answers.
    """
    kind, _, index = device.partition(":")
    if devices == 1:
        place = torch.device(kind, int(index or 0)) if kind == "cuda" else torch.device(kind)
        if kind == "cuda":
            torch.cuda.set_device(place)
        return OneProcess(place)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from lightning.fabric import Fabric
        from lightning.fabric.strategies.ddp import DDPStrategy
    # Fabric announces processes and devices, and torch 2.13 that broadcast_buffers will be renamed.
    for name in [name for name in logging.root.manager.loggerDict if name.startswith("lightning")]:
        logging.getLogger(name).setLevel(logging.ERROR)
    warnings.filterwarnings("ignore", message=".*broadcast_buffers")
    fabric = Fabric(
        accelerator="cuda" if kind == "cuda" else "cpu",
        devices=devices,
        # Buffers are constants; sending them before every call would also break networks that are called repeatedly.
        strategy=DDPStrategy(broadcast_buffers=False),
        precision="32-true",
    )
    fabric.launch()
    return fabric


def autocast(precision: Precision, device: torch.device) -> contextlib.AbstractContextManager[Any]:
    """Context for calls of a network, and of nothing else: the simulator's matrix products need all digits."""
    dtype = _DTYPES.get(precision)
    return torch.autocast(device.type, dtype) if dtype is not None else contextlib.nullcontext()


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

    @contextlib.contextmanager
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
