"""Reliefs of lines and their derivatives on any device: the model that lines are fitted with.

A line is a row of numbers (LINE_COLUMNS), all of them lengths in metres; derivatives of heights with respect to them
have no unit. How many numbers a line has, how far they may go and how far in one step is known here and in the kernel
only: a fit takes the Jacobian as it comes and moves lines by :meth:`LineModel.moved`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
import warp as wp

from warp_caustics.chunked import on_all_cores, warp_array, warp_stream
from warp_caustics.kernels.runtime import start_warp
from warp_caustics.prints.line import COSINE_EXPONENT, Line, Section
from warp_caustics.prints.line_kernels import line_derivatives, line_derivatives_by_row
from warp_caustics.prints.line_shape import COSINE_HALF, SHAPE_LIMITS, Shape, half_height, section_edge
from warp_caustics.prints.merged_kernels import (
    HIGHEST,
    merged_derivatives,
    merged_derivatives_by_row,
    printed_points,
)
from warp_caustics.prints.overlap import LEAST, joined, over
from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray

LINE_COLUMNS = ("x0_m", "y0_m", "x1_m", "y1_m", "width_m", "height_m")
WIDTH, HEIGHT = 4, 5
"""Columns."""
WIDER_BELLS = 1.1
"""Power that lets a Gaussian be 1.2 times as wide at half its height as a cosine may be: one of 4 mm, told as four
standard deviations, is 2.35 mm wide there, a cosine 2 mm."""
LARGEST_STEP_M = (1.5e-3, 1.5e-3, 1.5e-3, 1.5e-3, 5e-4, 4e-4)
"""Largest change of each column in one step of a fit [m]: from further away the derivatives tell nothing."""

LINES_AT_ONCE = 6
"""Rendered by one core of a CPU at a time."""


@dataclass(frozen=True)
class Limits:
    """What a line may be; wider than Tab. 3, so that a fit is not stopped at its edges.

    Attributes:
        reach: ends lie within so many half plates of the centre.
        width_m: smallest and largest width [m]; of sections that are narrower at half their height than the cosine
            is, such as Gaussians, what is as wide there, and a little more (``WIDER_BELLS``).
        height_m: smallest and largest height [m].
        drop_m: by how much more a round drop may be wide; a line by as much less as it is long [m].
    """

    reach: float = 1.08
    width_m: tuple[float, float] = (8e-5, 4.5e-3)
    height_m: tuple[float, float] = (1e-5, 2.6e-3)
    drop_m: float = 2e-3


def rows_of(lines: Sequence[Line]) -> torch.Tensor:
    """Lines as rows, shape [L, 6] (LINE_COLUMNS) [m], float64."""
    rows = [[*line.start_m, *line.end_m, line.width_m, line.height_m] for line in lines]
    return torch.tensor(rows, dtype=torch.float64).reshape(-1, len(LINE_COLUMNS))


def lines_of(rows: torch.Tensor) -> list[Line]:
    """Rows as lines."""
    return [Line((x0, y0), (x1, y1), width, height) for x0, y0, x1, y1, width, height in rows.tolist()]


class LineModel:
    """Heights of lines on a scene's grid.

    Args:
        scene: gives plate and samples.
        section: of the lines.
        device: where to compute.
        limits: what a line may be.
        supersampling: a sample is the mean of supersampling^2 points of its cell; 1 takes the height at its centre.

    Attributes:
        shape: of the section, that of ``section`` to begin with, and of crossings, where lines add up; fits move it.
    """

    def __init__(
        self,
        scene: Scene,
        section: Section = "cosine",
        device: str | torch.device = "cpu",
        limits: Limits | None = None,
        supersampling: int = 4,
    ):
        self.scene, self.section, self.device = scene, section, torch.empty(0, device=device).device  # with its number
        self.limits, self.supersampling = limits or Limits(), supersampling
        self.shape = Shape(COSINE_EXPONENT[section])
        self.n = scene.height_samples
        self._points = self.n, supersampling
        half = torch.tensor(scene.plate_size_m, dtype=torch.float64) / 2 * self.limits.reach
        (low_w, high_w), (low_h, high_h) = self.limits.width_m, self.limits.height_m
        self._low = torch.tensor([*(-half).tolist() * 2, low_w, low_h], dtype=torch.float64)
        self._high = torch.tensor([*half.tolist() * 2, high_w, high_h], dtype=torch.float64)
        self._wider, self._widened = 1.0, (self._low, self._high)
        self._step = torch.tensor(LARGEST_STEP_M, dtype=torch.float64)

    def parts(self, lines: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Each line alone, and its derivatives.

        Args:
            lines: shape [L, 6] [m], float64.

        Returns:
            Heights [m], shape [L, n, n], and derivatives [1], shape [L, 6, n, n], float32, on the device.
        """
        derivatives = _zeros(len(lines), len(LINE_COLUMNS), self.n, self.n, device=self.device)
        return self._rendered(lines, derivatives), derivatives

    def each(self, lines: torch.Tensor) -> torch.Tensor:
        """Heights of each line alone [m], shape [L, n, n]; a CPU takes four fifths of the time of :meth:`parts`."""
        return self._rendered(lines, _zeros(0, len(LINE_COLUMNS), self.n, self.n, device=self.device))

    def _rendered(self, lines: torch.Tensor, derivatives: torch.Tensor) -> torch.Tensor:
        """Heights of each line alone [m], shape [L, n, n]; derivatives of all or none are written, too."""
        start_warp()
        heights = _zeros(len(lines), self.n, self.n, device=self.device)
        if len(lines):
            rows = lines.to(self.device, torch.float32).contiguous()
            kernel = line_derivatives_by_row if self.device.type == "cpu" else line_derivatives
            self._launch(kernel, rows, [], [heights, derivatives])
        return heights

    def points(self, lines: torch.Tensor, others_m: torch.Tensor | None = None) -> torch.Tensor:
        """What is printed at the points of each cell where lines do not add up [m], shape [n, n, supersampling^2].

        Their mean is the relief. :meth:`joined`, of lines that are printed alone, is off by 3 um on a plate of ten
        lines of which the highest is printed, for the higher one changes within a cell.

        Args:
            lines: shape [L, 6] [m].
            others_m: points of what is printed already; bare plate if None.
        """
        start_warp()
        shape = self.n, self.n, self.supersampling**2
        found = torch.zeros(shape, device=self.device) if others_m is None else others_m.clone()
        rows = lines.to(self.device, torch.float32).contiguous()
        with warp_stream(self.device):
            wp.launch(
                printed_points,
                dim=shape[:2],
                inputs=[warp_array(rows), *self._told, self._power],
                outputs=[warp_array(found)],
                device=wp.device_from_torch(self.device),
            )
        return found

    def _launch(
        self, kernel: wp.Kernel, rows: torch.Tensor, inputs: list[Any], outputs: Sequence[torch.Tensor]
    ) -> None:
        """A kernel of single lines, of which outputs have one each; a launch of Warp runs on one core of a CPU."""
        of_cells, device = outputs[0].shape[-2:], self.device

        def launch(piece: slice) -> None:
            dim = len(rows[piece]), *(of_cells if device.type == "cuda" else of_cells[:1])
            told = [warp_array(rows[piece]), *self._told, *inputs]
            made = [warp_array(each[piece]) for each in outputs]
            wp.launch(kernel, dim=dim, inputs=told, outputs=made, device=wp.device_from_torch(device))

        with warp_stream(device):
            if device.type == "cuda" or len(rows) < 2 * LINES_AT_ONCE:
                launch(slice(None))
                return
            pieces = [slice(first, first + LINES_AT_ONCE) for first in range(0, len(rows), LINES_AT_ONCE)]
            for _ in on_all_cores(launch, pieces):
                pass

    @property
    def _told(self) -> tuple[float, ...]:
        """What kernels are told of shape and grid."""
        return *self._printed, *self.scene.sample_pitch_m, *self._points

    @property
    def _power(self) -> float:
        """p of :mod:`~warp_caustics.prints.overlap`, for kernels."""
        return HIGHEST if self.shape.overlap < LEAST else 1 / self.shape.overlap

    @property
    def _printed(self) -> tuple[float, ...]:
        """What kernels are told of the shape."""
        shape = self.shape
        return shape.exponent, shape.parabola, section_edge(shape), shape.is_cap, shape.thicker, shape.end_m

    def sketched(self, supersampling: int) -> "LineModel":
        """The same lines and section, with fewer points per cell."""
        sketch = LineModel(self.scene, self.section, self.device, self.limits, supersampling)
        sketch.shape = self.shape
        return sketch

    def _ends(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Least and largest numbers of a line of the present section, shape [6] [m]."""
        wider = max(1.0, COSINE_HALF / half_height(self.shape))
        if wider != self._wider:
            self._wider, self._widened = wider, (self._low.clone(), self._high.clone())
            self._widened[0][WIDTH] *= wider
            self._widened[1][WIDTH] *= wider**WIDER_BELLS
        return self._widened

    def over(self, heights: torch.Tensor, others: torch.Tensor) -> torch.Tensor:
        """Lines printed over others [m]; shapes that broadcast."""
        return over(heights, others, self.shape.overlap)

    def joined(self, parts: torch.Tensor) -> torch.Tensor:
        """Relief of lines [m], shape [n, n], from each alone, shape [L, n, n]; but for cells in which lines cross."""
        return joined(parts, self.shape.overlap)

    def without_each(self, parts: torch.Tensor) -> torch.Tensor:
        """Reliefs of all lines but one [m], shape [L, n, n], from each alone."""
        return self.without(parts, [(k,) for k in range(len(parts))])

    def without(self, parts: torch.Tensor, groups: Sequence[Sequence[int]]) -> torch.Tensor:
        """Reliefs of all lines but those of a group [m], shape [groups, n, n], from each alone; groups are as large."""
        if self.shape.overlap == 1:
            total = parts.sum(dim=0).expand(len(groups), *parts.shape[1:])
            return total - parts[torch.tensor(groups, device=parts.device)].sum(dim=1) if len(groups) else total
        rest = torch.zeros(len(groups), *parts.shape[1:], dtype=parts.dtype, device=parts.device)
        for printed, group in zip(rest, groups, strict=True):
            printed[...] = self.joined(parts[[k for k in range(len(parts)) if k not in group]])
        return rest

    def with_each(self, lines: torch.Tensor, tried: torch.Tensor) -> torch.Tensor:
        """Reliefs of lines with each of others besides [m], shape [K, n, n]; cells in which lines cross and all.

        Args:
            lines: shape [L, 6] [m].
            tried: one more each, shape [K, 6] [m], or several, [K, E, 6].
        """
        if self.shape.overlap == 1:
            parts = self.each(tried.reshape(-1, tried.shape[-1])).reshape(*tried.shape[:-1], self.n, self.n)
            return self.heights(lines) + (parts if tried.ndim == 2 else parts.sum(dim=1))
        if not len(tried):
            return _zeros(0, self.n, self.n, device=self.device)
        points = self.points(lines)
        more = tried if tried.ndim == 3 else tried[:, None]
        return torch.stack([self.points(some, points).mean(dim=-1) for some in more])

    def heights_without_each(self, lines: torch.Tensor) -> torch.Tensor:
        """Reliefs of all lines but one [m], shape [L, n, n]; cells in which lines cross and all."""
        if self.shape.overlap == 1:
            return self.without_each(self.each(lines))
        others = [[j for j in range(len(lines)) if j != k] for k in range(len(lines))]
        return torch.stack([self.heights(lines[some]) for some in others])

    def heights(self, lines: torch.Tensor) -> torch.Tensor:
        """Relief of all lines together [m], shape [n, n], float32."""
        if self.shape.overlap != 1:
            return self.points(lines).mean(dim=-1)
        return self.joined(self.each(lines))

    def with_jacobian(self, lines: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Relief of all lines together [m], shape [n, n], and its derivatives [1] by all numbers, shape [P, n, n]."""
        if self.shape.overlap == 1:
            heights, derivatives = self.parts(lines)
            return self.joined(heights), derivatives.flatten(0, 1)
        points = self.points(lines)
        derivatives = _zeros(len(lines), len(LINE_COLUMNS), self.n, self.n, device=self.device)
        if len(lines):
            rows, kernel = lines.to(self.device, torch.float32).contiguous(), merged_derivatives
            if self.device.type == "cpu":
                kernel = merged_derivatives_by_row
            self._launch(kernel, rows, [self._power, warp_array(points)], [derivatives])
        return points.mean(dim=-1), derivatives.flatten(0, 1)

    def moved(self, lines: torch.Tensor, step: torch.Tensor) -> torch.Tensor:
        """Lines after a step of a fit, shape [P], as far as one step and the limits allow."""
        rows = step.reshape(lines.shape)
        return self.clamped(lines + torch.minimum(torch.maximum(rows, -self._step), self._step))

    def limits_of(self, lines: torch.Tensor, of_shape: Sequence[int] = ()) -> tuple[FloatArray, FloatArray]:
        """Least and largest values of lines, shape [L, 6] [m], and of some numbers of a shape after them, shape [P]."""
        ends = []
        for of_lines, limit in zip(self._ends_of(lines), SHAPE_LIMITS, strict=True):
            whole = np.broadcast_to(of_lines.numpy(), lines.shape).ravel()
            ends.append(np.append(whole, [limit[number] for number in of_shape]))
        return ends[0], ends[1]

    def clamped(self, lines: torch.Tensor) -> torch.Tensor:
        """Lines within the limits, shape [..., 6] [m]."""
        low, high = self._ends_of(lines)
        return torch.minimum(torch.maximum(lines, low), high)

    def _ends_of(self, lines: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Least and largest numbers of each line, shape [..., 6] [m], or of all of them, [6], where none is short."""
        low, high = self._ends()
        # Asked ten thousands of times of a few lines: NumPy takes a third of the time.
        across = lines.numpy()[..., 2:4] - lines.numpy()[..., :2]
        length = np.sqrt(np.square(across).sum(axis=-1))
        if (length < self.limits.drop_m).any():
            high = high.expand(lines.shape).clone()
            high[..., WIDTH] += torch.from_numpy(np.maximum(self.limits.drop_m - length, 0.0))
        return low, high


def _zeros(*shape: int, device: torch.device) -> torch.Tensor:
    """Zeros that take memory only where something is written; on a GPU, which writes everything, anything."""
    if device.type == "cuda":
        return torch.empty(shape, device=device)
    return torch.from_numpy(np.zeros(shape, dtype=np.float32))
