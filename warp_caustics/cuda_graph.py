"""Replaying a fixed sequence of GPU launches at the cost of one."""

import gc
import threading
from collections.abc import Callable
from typing import Any

import torch

_KEEPERS: dict[tuple[int, int], torch.cuda.CUDAGraph] = {}
"""Of each GPU and thread a graph that keeps the memory which others there share."""
_STREAMS: dict[int, torch.cuda.Stream] = {}
"""Of each GPU the one that graphs are recorded on."""


def _shared_memory() -> Any:
    """Of graphs of this thread on the current GPU.

    Each would keep what its launches need for itself, and descents record one for each bench they look at: on a plate
    of twenty lines whose bench had to be found 4.2 GiB were in use at most, and 8.3 reserved. Graphs of one thread are
    replayed one after the other. A pool without graphs is lost, so that one that does nothing stays.
    """
    key = torch.cuda.current_device(), threading.get_ident()
    if key not in _KEEPERS:
        keeper = torch.cuda.CUDAGraph()
        with _recording(keeper):
            torch.zeros(1, device="cuda")
        _KEEPERS[key] = keeper
    return _KEEPERS[key].pool()


def _recording(graph: torch.cuda.CUDAGraph, pool: Any = None) -> torch.cuda.graph:
    """Records on a stream of the current GPU: without one torch takes that of the first on which any was recorded."""
    device = torch.cuda.current_device()
    if device not in _STREAMS:
        _STREAMS[device] = torch.cuda.Stream(device)
    return torch.cuda.graph(graph, pool=pool, stream=_STREAMS[device], capture_error_mode="thread_local")


def recorded(call: Callable[[], Any], *, is_copied: bool = False) -> tuple[torch.cuda.CUDAGraph, Any]:
    """The launches of a call as a graph, and what it returns: tensors that each replay overwrites.

    Args:
        call: only launches GPU work; it has run before, so that its kernels are loaded.
        is_copied: what a replay finds is copied before the next one of any graph, so that its memory may be theirs.
    """
    graph = torch.cuda.CUDAGraph()
    torch.cuda.synchronize()
    was_enabled = gc.isenabled()
    # The garbage collector may free an older graph, which must not happen while one is recorded; what is garbage by now
    # can wait: to look for it takes longer than to record.
    gc.disable()
    try:
        pool = _shared_memory() if is_copied else None
        with _recording(graph, pool):
            output = call()
    finally:
        if was_enabled:
            gc.enable()
    return graph, output


class CudaGraph:
    """A function of tensors, recorded once and replayed on copies of its inputs.

    Args:
        call: only launches GPU work, the same for inputs of the same shape; it has run before, so that
            its kernels are loaded.
        inputs: examples of its arguments.
    """

    def __init__(self, call: Callable[..., torch.Tensor], inputs: tuple[torch.Tensor, ...]):
        self.inputs = tuple(torch.empty_like(tensor).copy_(tensor) for tensor in inputs)
        with torch.no_grad():
            self.graph, self.output = recorded(lambda: call(*self.inputs), is_copied=True)

    def __call__(self, *inputs: torch.Tensor) -> torch.Tensor:
        """Result for these inputs, in memory of its own."""
        for kept, given in zip(self.inputs, inputs, strict=True):
            kept.copy_(given)
        self.graph.replay()
        output: torch.Tensor = self.output
        return output.clone()


class Replays:
    """CUDA graphs of calls, by their name and batch size.

    A call is recorded when it comes for the second time. Not at the first: recording costs a tenth of a second, and
    many simulators are called once.
    """

    def __init__(self) -> None:
        self._calls: dict[tuple[str, int], int] = {}
        self._graphs: dict[tuple[str, int], CudaGraph] = {}

    def __call__(self, key: tuple[str, int], call: Callable[..., torch.Tensor], *inputs: torch.Tensor) -> torch.Tensor:
        """Result of a call, through its graph where there is one.

        Args:
            key: name of the call, and batch size.
            call: as of :class:`CudaGraph`.
            inputs: its arguments.
        """
        self._calls[key] = self._calls.get(key, 0) + 1
        if self._calls[key] < 2 or torch.cuda.is_current_stream_capturing():
            return call(*inputs)
        if key not in self._graphs:
            self._graphs[key] = CudaGraph(call, inputs)
        return self._graphs[key](*inputs)
