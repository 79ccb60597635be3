"""Reliefs of lines that vary along their way, and the gradient of what is asked of a relief by all their numbers."""

from typing import Any

import torch
import warp as wp

from warp_caustics.chunked import warp_array, warp_stream
from warp_caustics.determinism import is_deterministic
from warp_caustics.kernels.runtime import start_warp
from warp_caustics.prints.line_shape import section_edge
from warp_caustics.prints.model import LineModel
from warp_caustics.prints.overlap import by_each, relief_of
from warp_caustics.prints.wavy_kernels import WavySection, wavy_heights, wavy_heights_adjoint

KNOT_M = 6e-4
"""Knots lie at most so far apart [m]: waves of 1.2 mm and more have two and more, height samples of the paper one and a
half."""
MARGIN = 1.5
"""Waves of lines that are being found stay within so many times the largest of now, or the least room."""
LEAST_ROOM = 0.05, 1e-4
"""Of thickness [1] and the way aside [m]."""


def knot_counts(lines: torch.Tensor, knot_m: float = KNOT_M) -> torch.Tensor:
    """How many knots lines [L, 6] [m] have, shape [L]; two at least."""
    lengths = (lines[:, 2:4] - lines[:, :2]).norm(dim=1)
    counts: torch.Tensor = (lengths / knot_m).ceil().clamp_min(1).to(torch.int32) + 1
    return counts


class WavyModel:
    """Lines with knots on a scene's grid; on a CPU where results are to be the same every time: gradients are added up.

    Args:
        model: of straight lines; its shape is that of these.
        counts: of knots, shape [L].
    """

    def __init__(self, model: LineModel, counts: torch.Tensor):
        start_warp()
        self.model, self.most = model, int(counts.max()) if len(counts) else 2
        self._device = torch.device("cpu") if is_deterministic() else model.device
        self._counts = counts.to(self._device, torch.int32).contiguous()

    def alone(self, lines: torch.Tensor, knots: torch.Tensor) -> torch.Tensor:
        """Each line alone [m], shape [L, n, n], float32; where lines do not add up at the points of cells.

        Those have the shape [L, n, n, supersampling^2].

        Args:
            lines: shape [L, 6] [m].
            knots: more thickness [1], above -1, and the way aside of the straight line, to the left [m], shape
                [L, K, 2].
        """
        n, adds_up = self.model.n, self.model.shape.overlap == 1
        count = 1 if adds_up else self.model.supersampling**2
        heights = torch.empty(len(lines), n, n, count, device=self._device)
        if len(lines):
            told, keep = self._told(lines, knots)
            self._launch(wavy_heights, told, [warp_array(heights)])
            del keep
        return (heights[..., 0] if adds_up else heights).to(self.model.device)

    def together(self, alone: torch.Tensor) -> torch.Tensor:
        """Relief of all together [m], shape [n, n], float32."""
        return relief_of(alone, self.model.shape.overlap)

    def heights(self, lines: torch.Tensor, knots: torch.Tensor) -> torch.Tensor:
        """Relief of all together [m], shape [n, n], float32."""
        return self.together(self.alone(lines, knots))

    def gradient(
        self, lines: torch.Tensor, knots: torch.Tensor, alone: torch.Tensor, by_height: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Of a function of the relief, by lines, shape [L, 6], and knots, shape [L, K, 2]; float64, on the CPU.

        Args:
            lines: shape [L, 6] [m].
            knots: shape [L, K, 2].
            alone: of these lines.
            by_height: the function's gradient by the relief [1/m], shape [n, n].
        """
        of_each = by_each(by_height, alone, self.model.shape.overlap)
        if of_each.ndim == 3:
            of_each = of_each[..., None]
        told, keep = self._told(lines, knots)
        of_each = of_each.to(self._device).contiguous()
        by_line = torch.zeros(len(lines), 6, device=self._device)
        by_knot = torch.zeros(len(lines), self.most, 2, device=self._device)
        self._launch(wavy_heights_adjoint, [*told, warp_array(of_each)], [warp_array(by_line), warp_array(by_knot)])
        del keep
        return by_line.double().cpu(), by_knot.double().cpu()

    def _told(self, lines: torch.Tensor, knots: torch.Tensor) -> tuple[list[Any], list[torch.Tensor]]:
        """What both kernels are told, and what of it must not go before they have run."""
        model, shape = self.model, self.model.shape
        section: Any = WavySection()
        section.exponent, section.parabola, section.edge = shape.exponent, shape.parabola, section_edge(shape)
        section.is_cap, section.thicker, section.end = shape.is_cap, shape.thicker, shape.end_m
        room = [max(MARGIN * float(knots[..., k].abs().max()), LEAST_ROOM[k]) for k in (0, 1)]
        section.thickest, section.aside = (1 + shape.thicker) * (1 + room[0]), room[1]
        kept = [values.to(self._device, torch.float32).contiguous() for values in (lines, knots)]
        told = [*map(warp_array, kept), warp_array(self._counts), section, wp.vec2(*model.scene.sample_pitch_m)]
        return [*told, model.n, model.supersampling], kept

    def _launch(self, kernel: wp.Kernel, inputs: list[Any], outputs: list[Any]) -> None:
        device = self._device
        with warp_stream(device):
            wp.launch(
                kernel,
                dim=(len(self._counts), self.model.n, self.model.n),
                inputs=inputs,
                outputs=outputs,
                device=wp.device_from_torch(device),
            )
