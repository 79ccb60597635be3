"""Replaying a fixed sequence of GPU launches at the cost of one."""

import gc
from collections.abc import Callable
from typing import Any

import torch


def recorded(call: Callable[[], Any]) -> tuple[torch.cuda.CUDAGraph, Any]:
    """The launches of a call as a graph, and what it returns: tensors that each replay overwrites.

    Args:
        call: only launches GPU work; it has run before, so that its kernels are loaded.
    """
    graph = torch.cuda.CUDAGraph()
    torch.cuda.synchronize()
    was_enabled = gc.isenabled()
    # The garbage collector may free an older graph, which must not happen while one is recorded; what is garbage by now
    # can wait: to look for it takes longer than to record.
    gc.disable()
    try:
        with torch.cuda.graph(graph, capture_error_mode="thread_local"):
            output = call()
    finally:
        if was_enabled:
            gc.enable()
    return graph, output


Beside = tuple[Callable[..., None], Callable[[], None]]
"""What is asked of the inputs besides: launches to record, and what the host does after each replay of them."""

Finish = Callable[[torch.Tensor], torch.Tensor]
"""The last launches of a call, whose result is memory of its own or what they are given."""


class CudaGraph:
    """A function of tensors, recorded once and replayed on copies of its inputs.

    Args:
        call: only launches GPU work, the same for inputs of the same shape; it has run before, so that
            its kernels are loaded.
        inputs: examples of its arguments.
        beside: recorded as a graph of its own, which the GPU runs at the same time, so that the host can learn what it
            finds before the call is done. Whoever asks waits for it before the next call.
        finish: makes the result of what the call returns, launch by launch: what is written there need not be copied.
    """

    def __init__(
        self,
        call: Callable[..., torch.Tensor],
        inputs: tuple[torch.Tensor, ...],
        beside: Beside | None = None,
        finish: Finish | None = None,
    ):
        self.inputs = tuple(torch.empty_like(tensor).copy_(tensor) for tensor in inputs)
        self._beside = None if beside is None else _BesideGraph(beside, self.inputs)
        self._finish = finish
        with torch.no_grad():
            self.graph, self.output = recorded(lambda: call(*self.inputs))

    def __call__(self, *inputs: torch.Tensor) -> torch.Tensor:
        """Result for these inputs, in memory of its own."""
        for kept, given in zip(self.inputs, inputs, strict=True):
            kept.copy_(given)
        if self._beside is not None:
            self._beside.are_copied()
        self.graph.replay()
        if self._beside is not None:
            self._beside.replay()
        output: torch.Tensor = self.output
        found = output if self._finish is None else self._finish(output)
        return output.clone() if found is output else found


class _BesideGraph:
    """Launches on a stream of their own: a GPU that is busy with the call takes them first.

    Args:
        beside: what is asked of the inputs.
        inputs: the graph's copies.
    """

    def __init__(self, beside: Beside, inputs: tuple[torch.Tensor, ...]):
        begin, self._then = beside
        with torch.no_grad():
            self._graph, _ = recorded(lambda: begin(*inputs))
        self._stream, self._copied = torch.cuda.Stream(inputs[0].device, priority=-1), torch.cuda.Event()

    def are_copied(self) -> None:
        """Told where the copies are."""
        self._copied.record(torch.cuda.current_stream(self._stream.device))

    def replay(self) -> None:
        self._stream.wait_event(self._copied)
        with torch.cuda.stream(self._stream):
            self._graph.replay()
            self._then()


class Replays:
    """CUDA graphs of calls, by their name and batch size.

    A call is recorded when it comes for the second time. Not at the first: recording costs a tenth of a second, and
    many simulators are called once.
    """

    def __init__(self) -> None:
        self._calls: dict[tuple[str, int], int] = {}
        self._graphs: dict[tuple[str, int], CudaGraph] = {}

    def __call__(
        self,
        name: str,
        call: Callable[..., torch.Tensor],
        *inputs: torch.Tensor,
        beside: Beside | None = None,
        finish: Finish | None = None,
    ) -> torch.Tensor:
        """Result of a call, through its graph where there is one; the rest as of :class:`CudaGraph`."""
        key = name, inputs[0].shape[0]
        self._calls[key] = self._calls.get(key, 0) + 1
        if self._calls[key] < 2 or torch.cuda.is_current_stream_capturing():
            if beside is not None:
                begin, then = beside
                begin(*inputs)
                then()
            found = call(*inputs)
            return found if finish is None else finish(found)
        if key not in self._graphs:
            self._graphs[key] = CudaGraph(call, inputs, beside, finish)
        return self._graphs[key](*inputs)
