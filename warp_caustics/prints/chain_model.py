"""Reliefs of lines along chains of points, and the gradient of what is asked of a relief by points and sizes."""

from typing import Any

import torch
import warp as wp

from warp_caustics.chunked import warp_array, warp_stream
from warp_caustics.determinism import is_deterministic
from warp_caustics.kernels.runtime import start_warp
from warp_caustics.prints.chain_kernels import BLOCK, TILE, ChainSection, chain_heights, chain_heights_adjoint
from warp_caustics.prints.model import LineModel, section_edge
from warp_caustics.prints.overlap import share


class ChainModel:
    """Lines along chains on a scene's grid; on a CPU where results are to be the same every time: gradients are summed.

    Args:
        model: of straight lines; its section and overlap are those of these.
    """

    def __init__(self, model: LineModel):
        start_warp()
        self.model = model
        self._device = torch.device("cpu") if is_deterministic() else model.device

    def parts(self, points: torch.Tensor, sizes: torch.Tensor) -> torch.Tensor:
        """Each line alone [m], shape [L, n, n], float32.

        Args:
            points: of chains [m], shape [L, K, 2]; those with fewer repeat their last.
            sizes: widths and heights [m], shape [L, 2].
        """
        n = self.model.n
        heights = torch.empty(len(points), n, n, device=self._device)
        if len(points):
            told, keep = self._told(points, sizes)
            self._launch(chain_heights, len(points), told, [warp_array(heights)])
            del keep
        return heights.to(self.model.device)

    def heights(self, points: torch.Tensor, sizes: torch.Tensor) -> torch.Tensor:
        """Relief of all together [m], shape [n, n], float32."""
        return self.model.joined(self.parts(points, sizes))

    def gradient(
        self, points: torch.Tensor, sizes: torch.Tensor, parts: torch.Tensor, by_height: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Of a function of the relief, by points, shape [L, K, 2], and sizes, shape [L, 2]; float64, on the CPU.

        Args:
            points: shape [L, K, 2] [m].
            sizes: shape [L, 2] [m].
            parts: of these lines.
            by_height: the function's gradient by the relief [1/m], shape [n, n].
        """
        of_each = by_height.expand_as(parts)
        if self.model.shape.overlap != 1:
            of_each = of_each * share(parts, self.model.joined(parts), self.model.shape.overlap)
        told, keep = self._told(points, sizes)
        of_each = of_each.to(self._device).contiguous()
        by_point = torch.zeros(keep[0].shape, device=self._device)
        by_size = torch.zeros(len(sizes), 2, device=self._device)
        outputs = [warp_array(by_point), warp_array(by_size)]
        self._launch(chain_heights_adjoint, len(points), [*told, warp_array(of_each)], outputs)
        # What was filled up repeats the last point.
        count = points.shape[1]
        summed = by_point[:, :count].double().cpu()
        summed[:, -1] += by_point[:, count:].double().sum(1).cpu()
        return summed, by_size.double().cpu()

    def _told(self, points: torch.Tensor, sizes: torch.Tensor) -> tuple[list[Any], list[torch.Tensor]]:
        """What both kernels are told, and what of it must not go before they have run."""
        model, shape = self.model, self.model.shape
        section: Any = ChainSection()
        section.exponent, section.parabola, section.edge = shape.exponent, shape.parabola, section_edge(shape)
        section.is_cap = shape.is_cap
        count = points.shape[1]
        missing = (1 - count) % BLOCK if count > 1 else BLOCK
        filled = torch.cat([points, points[:, -1:].expand(-1, missing, -1)], dim=1)
        blocks = filled.unfold(1, BLOCK + 1, BLOCK)  # a piece ends in the point where the next block begins
        boxes = torch.cat([blocks.amin(-1), blocks.amax(-1)], dim=-1)
        kept = [values.to(self._device, torch.float32).contiguous() for values in (filled, boxes, sizes)]
        told = [*map(warp_array, kept), section, wp.vec2(*model.scene.sample_pitch_m)]
        return [*told, model.n, model.supersampling], kept

    def _launch(self, kernel: wp.Kernel, lines: int, inputs: list[Any], outputs: list[Any]) -> None:
        device, n = self._device, self.model.n
        with warp_stream(device):
            dim = lines, n, -(-n // TILE)
            wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs, device=wp.device_from_torch(device))
