"""Reliefs of lines and their derivatives on any device: the model that lines are fitted with.

A line is a row of numbers (LINE_COLUMNS), all of them lengths in metres; derivatives of heights with respect to them
have no unit. How many numbers a line has, how far they may go and how far in one step is known here and in the kernel
only: a fit takes the Jacobian as it comes and moves lines by :meth:`LineModel.moved`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy  # loads its parts when they are first used
import torch
import warp as wp

from warp_caustics.chunked import on_all_cores, warp_array, warp_stream
from warp_caustics.kernels.runtime import start_warp
from warp_caustics.prints.kernels import line_derivatives, line_derivatives_by_row
from warp_caustics.prints.line import COSINE_EXPONENT, Line, Section
from warp_caustics.prints.overlap import joined, over, share
from warp_caustics.prints.sections import EXPONENTS
from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray

LINE_COLUMNS = ("x0_m", "y0_m", "x1_m", "y1_m", "width_m", "height_m")
WIDTH, HEIGHT = 4, 5
"""Columns."""
LARGEST_STEP_M = (1.5e-3, 1.5e-3, 1.5e-3, 1.5e-3, 5e-4, 4e-4)
"""Largest change of each column in one step of a fit [m]: from further away the derivatives tell nothing."""

LINES_AT_ONCE = 6
"""Rendered by one core of a CPU at a time."""
EXPONENT_STEP = 0.01
"""Of differences by the exponent, relative to it: errs by 1e-4 of them, float32 by as much."""
PARABOLA_STEP = 0.02
"""The same by the share of the parabola."""

OVERLAP_STEP = 0.02
"""The same by what is printed where lines cross."""


class Shape(NamedTuple):
    """What all lines of a print have in common: their section and what is printed where they cross.

    The section is ((1 - p) cos(pi t / 2)^2 + p (1 - t^2))^g with t = 2 r / w: cosines and parabolas of any power, with
    the ellipse (p = 1, g = 0.5), and what lies between.
    """

    exponent: float = 1.0
    """g."""
    parabola: float = 0.0
    """p, from 0 to 1."""
    overlap: float = 1.0
    """q of :mod:`~warp_caustics.prints.overlap`: at 1 lines add up where they cross, at 0 the highest is printed."""

    def clipped(self) -> "Shape":
        """Within what prints have."""
        return Shape(*(min(max(at, low), high) for at, low, high in zip(self, *SHAPE_LIMITS, strict=True)))


SHAPE_LIMITS = (Shape(EXPONENTS[0], 0.0, 0.0), Shape(EXPONENTS[1], 1.0, 1.0))
"""Of each of its numbers: the least and the largest that prints have."""


def line_section(shape: Shape, t: FloatArray) -> FloatArray:
    """Height relative to the crown [1] at t = 2 r / w, any shape; 0 from the edge on: the oracle of the kernel."""
    inside = np.clip(np.abs(t), 0.0, 1.0)
    base = (1 - shape.parabola) * np.cos(np.pi / 2 * inside) ** 2 + shape.parabola * (1 - inside**2)
    height: FloatArray = np.maximum(base, 0.0) ** shape.exponent
    return height


def half_height(shape: Shape) -> float:
    """t = 2 r / w at which the section is half as high as its crown [1]."""
    found = scipy.optimize.brentq(lambda t: float(line_section(shape, np.array(t))) - 0.5, 0.0, 1.0, xtol=1e-12)
    return float(found)


@dataclass(frozen=True)
class Limits:
    """What a line may be; wider than Tab. 3, so that a fit is not stopped at its edges.

    Attributes:
        reach: ends lie within so many half plates of the centre.
        width_m: smallest and largest width [m].
        height_m: smallest and largest height [m].
    """

    reach: float = 1.08
    width_m: tuple[float, float] = (8e-5, 4.5e-3)
    height_m: tuple[float, float] = (1e-5, 2.6e-3)


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
        self.scene, self.section, self.device = scene, section, torch.device(device)
        self.limits, self.supersampling = limits or Limits(), supersampling
        self.shape = Shape(COSINE_EXPONENT[section])
        self.n = scene.height_samples
        half = torch.tensor(scene.plate_size_m, dtype=torch.float64) / 2 * self.limits.reach
        (low_w, high_w), (low_h, high_h) = self.limits.width_m, self.limits.height_m
        self._low = torch.tensor([*(-half).tolist() * 2, low_w, low_h], dtype=torch.float64)
        self._high = torch.tensor([*half.tolist() * 2, high_w, high_h], dtype=torch.float64)
        self._step = torch.tensor(LARGEST_STEP_M, dtype=torch.float64)

    def parts(self, lines: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Each line alone, and its derivatives.

        Args:
            lines: shape [L, 6] [m], float64.

        Returns:
            Heights [m], shape [L, n, n], and derivatives [1], shape [L, 6, n, n], float32, on the device.
        """
        start_warp()
        n, count = self.n, len(lines)
        heights = _zeros(count, n, n, device=self.device)
        derivatives = _zeros(count, len(LINE_COLUMNS), n, n, device=self.device)
        if not count:
            return heights, derivatives
        rows = lines.to(self.device, torch.float32).contiguous()
        if self.device.type == "cuda" or count < 2 * LINES_AT_ONCE:
            self._launch(rows, heights, derivatives)
            return heights, derivatives
        # A launch of Warp runs on one core of a CPU.
        pieces = [slice(first, first + LINES_AT_ONCE) for first in range(0, count, LINES_AT_ONCE)]
        for _ in on_all_cores(lambda piece: self._launch(rows[piece], heights[piece], derivatives[piece]), pieces):
            pass
        return heights, derivatives

    def _launch(self, rows: torch.Tensor, heights: torch.Tensor, derivatives: torch.Tensor) -> None:
        pitch_x, pitch_y = self.scene.sample_pitch_m
        is_cuda = self.device.type == "cuda"
        with warp_stream(self.device):
            wp.launch(
                line_derivatives if is_cuda else line_derivatives_by_row,
                dim=heights.shape if is_cuda else heights.shape[:2],
                inputs=[warp_array(rows), *self.shape[:2], pitch_x, pitch_y, self.n, self.supersampling],
                outputs=[warp_array(heights), warp_array(derivatives)],
                device=wp.device_from_torch(self.device),
            )

    def sketched(self, supersampling: int) -> "LineModel":
        """The same lines and section, with fewer points per cell."""
        sketch = LineModel(self.scene, self.section, self.device, self.limits, supersampling)
        sketch.shape = self.shape
        return sketch

    def by_shape(self, lines: torch.Tensor) -> torch.Tensor:
        """Derivatives of the relief by the numbers of its shape [m], shape [3, n, n], by differences.

        Central ones by the exponent, and by the others where they are not at an end of their range.
        """
        given = self.shape
        step = EXPONENT_STEP * given.exponent
        # Heights at the edge of the exponent's range are told beyond it as well.
        ends = [tuple(given._replace(exponent=given.exponent + s * step) for s in (-1, 1))]
        for name, by in (("parabola", PARABOLA_STEP), ("overlap", OVERLAP_STEP)):
            at = getattr(given, name)
            ends.append(tuple(given._replace(**{name: min(max(at + s * by, 0.0), 1.0)}) for s in (-1, 1)))
        columns = []
        try:
            for number, pair in enumerate(ends):
                found = []
                for shape in pair:
                    self.shape = shape
                    found.append(self.heights(lines))
                columns.append((found[1] - found[0]) / (pair[1][number] - pair[0][number]))
        finally:
            self.shape = given
        return torch.stack(columns)

    def over(self, heights: torch.Tensor, others: torch.Tensor) -> torch.Tensor:
        """Lines printed over others [m]; shapes that broadcast."""
        return over(heights, others, self.shape.overlap)

    def joined(self, parts: torch.Tensor) -> torch.Tensor:
        """Relief of lines [m], shape [n, n], from each alone, shape [L, n, n]."""
        return joined(parts, self.shape.overlap)

    def without_each(self, parts: torch.Tensor) -> torch.Tensor:
        """Reliefs of all lines but one [m], shape [L, n, n], from each alone."""
        if self.shape.overlap == 1:
            return parts.sum(dim=0) - parts
        rest = torch.zeros_like(parts)
        for k in range(len(parts)):
            rest[k] = self.joined(torch.cat([parts[:k], parts[k + 1 :]]))
        return rest

    def heights(self, lines: torch.Tensor) -> torch.Tensor:
        """Relief of all lines together [m], shape [n, n], float32."""
        return self.joined(self.parts(lines)[0])

    def with_jacobian(self, lines: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Relief of all lines together [m], shape [n, n], and its derivatives [1] by all numbers, shape [P, n, n]."""
        heights, derivatives = self.parts(lines)
        total = self.joined(heights)
        if self.shape.overlap != 1:
            derivatives = derivatives * share(heights, total, self.shape.overlap)[:, None]
        return total, derivatives.flatten(0, 1)

    def moved(self, lines: torch.Tensor, step: torch.Tensor) -> torch.Tensor:
        """Lines after a step of a fit, shape [P], as far as one step and the limits allow."""
        rows = step.reshape(lines.shape)
        return self.clamped(lines + torch.minimum(torch.maximum(rows, -self._step), self._step))

    def limits_of(self, lines: int, *, with_shape: bool) -> tuple[FloatArray, FloatArray]:
        """Least and largest values of the numbers of so many lines [m], and of a shape after them, shape [P]."""
        ends = []
        for of_line, of_shape in ((self._low, SHAPE_LIMITS[0]), (self._high, SHAPE_LIMITS[1])):
            ends.append(np.append(np.tile(of_line.numpy(), lines), of_shape if with_shape else ()))
        return ends[0], ends[1]

    def clamped(self, lines: torch.Tensor) -> torch.Tensor:
        """Lines within the limits, shape [L, 6] [m]."""
        return torch.minimum(torch.maximum(lines, self._low), self._high)


def _zeros(*shape: int, device: torch.device) -> torch.Tensor:
    """Zeros that take memory only where something is written; on a GPU, which writes everything, anything."""
    if device.type == "cuda":
        return torch.empty(shape, device=device)
    return torch.from_numpy(np.zeros(shape, dtype=np.float32))
