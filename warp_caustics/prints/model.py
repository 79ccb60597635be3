"""Reliefs of lines and their derivatives on any device: the model that lines are fitted with.

A line is a row of numbers (LINE_COLUMNS), all of them lengths in metres; derivatives of heights with respect to them
have no unit. How many numbers a line has, how far they may go and how far in one step is known here and in the kernel
only: a fit takes the Jacobian as it comes and moves lines by :meth:`LineModel.moved`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
import warp as wp

from warp_caustics.chunked import on_all_cores, warp_array, warp_stream
from warp_caustics.kernels.runtime import start_warp
from warp_caustics.prints.kernels import line_derivatives, line_derivatives_by_row
from warp_caustics.prints.line import COSINE_EXPONENT, Line, Section
from warp_caustics.scene import Scene

LINE_COLUMNS = ("x0_m", "y0_m", "x1_m", "y1_m", "width_m", "height_m")
WIDTH, HEIGHT = 4, 5
"""Columns."""
LARGEST_STEP_M = (1.5e-3, 1.5e-3, 1.5e-3, 1.5e-3, 5e-4, 4e-4)
"""Largest change of each column in one step of a fit [m]: from further away the derivatives tell nothing."""

LINES_AT_ONCE = 6
"""Rendered by one core of a CPU at a time."""
EXPONENT_STEP = 0.01
"""Of differences by the exponent, relative to it: errs by 1e-4 of them, float32 by as much."""


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
        exponent: g of the section cos(pi r / w)^(2 g), that of ``section`` to begin with; a fit may move it.
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
        self.exponent = COSINE_EXPONENT[section]
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
                inputs=[warp_array(rows), self.exponent, pitch_x, pitch_y, self.n, self.supersampling],
                outputs=[warp_array(heights), warp_array(derivatives)],
                device=wp.device_from_torch(self.device),
            )

    def sketched(self, supersampling: int) -> "LineModel":
        """The same lines and section, with fewer points per cell."""
        sketch = LineModel(self.scene, self.section, self.device, self.limits, supersampling)
        sketch.exponent = self.exponent
        return sketch

    def by_exponent(self, lines: torch.Tensor) -> torch.Tensor:
        """Derivative of the relief by the exponent [m], shape [n, n], by a central difference."""
        given, found = self.exponent, []
        try:
            for sign in (1, -1):
                self.exponent = given * (1 + sign * EXPONENT_STEP)
                found.append(self.heights(lines))
        finally:
            self.exponent = given
        return (found[0] - found[1]) / (2 * given * EXPONENT_STEP)

    def heights(self, lines: torch.Tensor) -> torch.Tensor:
        """Relief of all lines together [m], shape [n, n], float32."""
        return self.parts(lines)[0].sum(dim=0)

    def with_jacobian(self, lines: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Relief of all lines together [m], shape [n, n], and its derivatives [1] by all numbers, shape [P, n, n]."""
        heights, derivatives = self.parts(lines)
        return heights.sum(dim=0), derivatives.flatten(0, 1)

    def moved(self, lines: torch.Tensor, step: torch.Tensor) -> torch.Tensor:
        """Lines after a step of a fit, shape [P], as far as one step and the limits allow."""
        rows = step.reshape(lines.shape)
        return self.clamped(lines + torch.minimum(torch.maximum(rows, -self._step), self._step))

    def clamped(self, lines: torch.Tensor) -> torch.Tensor:
        """Lines within the limits, shape [L, 6] [m]."""
        return torch.minimum(torch.maximum(lines, self._low), self._high)


def _zeros(*shape: int, device: torch.device) -> torch.Tensor:
    """Zeros that take memory only where something is written; on a GPU, which writes everything, anything."""
    if device.type == "cuda":
        return torch.empty(shape, device=device)
    return torch.from_numpy(np.zeros(shape, dtype=np.float32))
