"""The normal equations of lines about a relief as one launch of a GPU, which are what a fit waits for.

Thirty launches, each of which the host takes longer to ask for than a GPU to do, are one CUDA graph: it is told lines
and shape in memory, and leaves losses, matrices and right sides in memory of the host.
"""

from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import torch
import warp as wp

from warp_caustics.chunked import warp_stream
from warp_caustics.cuda_graph import recorded
from warp_caustics.kernels.runtime import start_warp
from warp_caustics.prints.fit_kernels import lines_alone, weigh_each, weigh_together
from warp_caustics.prints.line_shape import section_edge
from warp_caustics.prints.model import LineModel

COUNTS = (1, 2, 3, 4, 6, 8, 10, 12, 16, 20, 24, 28, 32, 40, 48, 64)
"""Lines that there are graphs for; fewer are told with others that are nowhere."""
MOST_BYTES = 2**28
"""Of a system; larger ones are not recorded."""
KEPT_BYTES = 2**29
"""Of all that are kept for another fit; where there would be more, as of several grids, they are forgotten."""
NUMBERS = 6
"""Of a line."""
TRAITS = 7
"""Numbers of a shape."""
NOWHERE_M = (1e3, 1e3, 1e3, 1e3, 1e-4, 0.0)
"""A line that is on no plate."""
PLANES, LEFT, LOSS = 8, 6, 7
"""Of each line for itself: its derivatives, what is left, and one, of which the weighted one is the loss."""
BLOCK_ROWS = 8
"""Rows of a relief that are summed by one product of a batch: those of a whole relief would keep a GPU waiting."""
UNRECORDED = 1
"""Launches before a graph is recorded: kernels load in the first."""
DEVICES = ("cuda",)
"""On a CPU, which nobody waits for, what is far from a line is better left out."""

System = tuple[torch.Tensor, torch.Tensor, torch.Tensor]
"""Losses, normal matrices and right sides, float64, on the CPU."""


class FitSystem:
    """Memory and launches of the normal equations of so many lines.

    Args:
        model: of the lines; any of the same grid and device can be told of later.
        count: lines at most.
        is_each: whether each line is fitted for itself, or all together.
    """

    def __init__(self, model: LineModel, count: int, *, is_each: bool):
        start_warp()
        n, device = model.n, model.device
        self.count, self.is_each, self._is_gpu = count, is_each, device.type == "cuda"
        self._pitch, self._points = model.scene.sample_pitch_m, model.supersampling
        self._told = torch.zeros(count * NUMBERS + TRAITS, pin_memory=self._is_gpu)
        self._tell, self._nowhere = self._told.numpy(), np.tile(np.array(NOWHERE_M, np.float32), count)
        here = self._told.to(device)
        self._here, self._lines, self._traits = here, here[: count * NUMBERS].view(count, NUMBERS), here[-TRAITS:]
        self._relief, self._inverse_variance = (torch.zeros(n, n, device=device) for _ in range(2))
        self._printed = torch.zeros((count, n, n) if is_each else (n, n), device=device)
        self._heights = torch.zeros(count, n, n, device=device)
        block = BLOCK_ROWS if n % BLOCK_ROWS == 0 else n
        planes = (count * (n // block), PLANES, block, n) if is_each else (count + 1, NUMBERS, n, n)
        self._jacobians, self._weighted = (torch.zeros(planes, device=device) for _ in range(2))
        (self._jacobians[:, LOSS] if is_each else self._jacobians[count, 1]).fill_(1.0)
        side = PLANES if is_each else (count + 1) * NUMBERS
        self._found = torch.zeros((count, side, side) if is_each else (side, side), pin_memory=self._is_gpu)
        self._calls, self._is_alone = 0, True
        self._graph: torch.cuda.CUDAGraph | None = None

    def about(self, relief_m: torch.Tensor, sigma_m: torch.Tensor, printed_m: torch.Tensor | None) -> None:
        """What is to be explained, how well, and what is printed already, shapes [n, n] or, of each, [L, n, n] [m]."""
        self._relief.copy_(relief_m)
        self._is_alone = printed_m is None
        torch.reciprocal(sigma_m.square(), out=self._inverse_variance)
        if printed_m is None:
            self._printed.zero_()
        else:
            (self._printed[: len(printed_m)] if self.is_each else self._printed).copy_(printed_m)

    def __call__(self, model: LineModel, lines: torch.Tensor) -> System:
        """Of lines [L, 6] [m], at most so many, with the model's shape; a GPU is waited for once.

        Of all together: the loss [], the matrix [6 L, 6 L] and the right side [6 L]; of each for itself [L],
        [L, 6, 6] and [L, 6].
        """
        shape, numbers, rest = model.shape, lines.numel(), self.count * NUMBERS
        self._tell[:numbers] = lines.numpy().reshape(-1)
        self._tell[numbers:rest] = self._nowhere[numbers:]
        traits = (shape.exponent, shape.parabola, section_edge(shape), shape.is_cap, shape.thicker, shape.end_m)
        # What is alone adds up with nothing, whatever is printed where lines cross.
        self._tell[rest:] = (*traits, 1.0 if self.is_each and self._is_alone else shape.overlap)
        self._run()
        found = self._found.double()
        if self.is_each:
            found = found[: len(lines)]
            return found[:, LOSS, LOSS], found[:, :NUMBERS, :NUMBERS], found[:, :NUMBERS, LEFT]
        loss, right = found[rest + 1, rest + 1], found[:numbers, rest]
        return loss, found[:numbers, :numbers], right

    def _run(self) -> None:
        if not self._is_gpu:
            self._launch()
            return
        self._calls += 1
        if self._graph is None and self._calls > UNRECORDED and not torch.cuda.is_current_stream_capturing():
            self._graph = recorded(self._launch)[0]
        if self._graph is None:
            self._launch()
        else:
            self._graph.replay()
        torch.cuda.current_stream(self._here.device).synchronize()

    def _launch(self) -> None:
        self._here.copy_(self._told, non_blocking=True)
        device = wp.device_from_torch(self._here.device)
        n = self._relief.shape[0]
        relief = [wp.from_torch(each) for each in (self._printed, self._relief, self._inverse_variance, self._traits)]
        heights, jacobians, weighted = (wp.from_torch(e) for e in (self._heights, self._jacobians, self._weighted))
        lines = [wp.from_torch(self._lines), relief[-1], *self._pitch, n, self._points]
        weigh, over = (weigh_each, (self.count, n, n)) if self.is_each else (weigh_together, (n, n))
        with warp_stream(self._here.device):
            wp.launch(lines_alone, (self.count, n, n), lines, [heights, jacobians], device=device)
            wp.launch(weigh, over, [heights, *relief], [jacobians, weighted], device=device)
        if self.is_each:
            left, right = (planes.flatten(2) for planes in (self._weighted, self._jacobians))
            blocks = torch.bmm(left, right.transpose(1, 2))
            found = blocks.view(self.count, -1, PLANES, PLANES).sum(dim=1)
        else:
            left, right = (planes.view(-1, n * n) for planes in (self._weighted, self._jacobians))
            found = left @ right.T
        self._found.copy_(found, non_blocking=True)

    @property
    def bytes(self) -> int:
        """Memory on the device, without what products take meanwhile."""
        kept = (self._jacobians, self._weighted, self._heights, self._printed, self._relief, self._inverse_variance)
        return sum(each.nbytes for each in kept)


_Key = tuple[torch.device, int, tuple[float, float], int, int, bool]
_UNUSED: dict[_Key, list[FitSystem]] = defaultdict(list)
"""Systems that nobody uses now; one that is used is in nobody else's hands."""


@contextmanager
def fit_system(model: LineModel, count: int, *, is_each: bool) -> Iterator[FitSystem | None]:
    """A system for so many lines of a model's grid, kept for the next fit; None where there is none, as on a CPU."""
    most = next((at for at in COUNTS if at >= count), None)
    if model.device.type not in DEVICES or most is None or 8 * (most + 1) * PLANES * model.n**2 > MOST_BYTES:
        yield None
        return
    key = (model.device, model.n, model.scene.sample_pitch_m, model.supersampling, most, is_each)
    try:
        system = _UNUSED[key].pop()
    except IndexError:
        system = FitSystem(model, most, is_each=is_each)
    try:
        yield system
    finally:
        if sum(each.bytes for kept in list(_UNUSED.values()) for each in kept) + system.bytes > KEPT_BYTES:
            _UNUSED.clear()
        _UNUSED[key].append(system)
