"""Reliefs of lines along chains of points, and the gradient of what is asked of a relief by points and sizes."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
import warp as wp

from warp_caustics.chunked import warp_array, warp_stream
from warp_caustics.determinism import is_deterministic
from warp_caustics.kernels.runtime import start_warp
from warp_caustics.prints.chain_kernels import BLOCK, TILE, ChainSection, chain_heights, chain_heights_adjoint
from warp_caustics.prints.line_shape import section_edge
from warp_caustics.prints.model import LineModel
from warp_caustics.prints.overlap import by_each, relief_of
from warp_caustics.types import FloatArray


@dataclass(frozen=True, eq=False)
class PlacedChains:
    """Chains where a model can print them.

    Attributes:
        points: filled up to whole blocks [m], shape [L, K', 2], float32, on the model's device.
        boxes: around each block (x_low, y_low, x_high, y_high) [m], shape [L, blocks, 4].
        sizes: widths and heights [m], shape [L, 2].
        count: points of each that were told, K.
    """

    points: torch.Tensor
    boxes: torch.Tensor
    sizes: torch.Tensor
    count: int

    def __len__(self) -> int:
        return len(self.points)


class ChainModel:
    """Lines along chains on a scene's grid; on a CPU where results are to be the same every time: gradients are summed.

    Args:
        model: of straight lines; its section and overlap are those of these.
    """

    def __init__(self, model: LineModel):
        start_warp()
        self.model = model
        self._device = torch.device("cpu") if is_deterministic() else model.device

    def placed(self, points: FloatArray, sizes: FloatArray) -> PlacedChains:
        """Chains as they are printed: told once for their relief and its gradient.

        Args:
            points: of chains [m], shape [L, K, 2]; those with fewer repeat their last.
            sizes: widths and heights [m], shape [L, 2].
        """
        lines, count = points.shape[:2]
        blocks = max(-(-(count - 1) // BLOCK), 1)
        filled = np.empty((lines, BLOCK * blocks + 1, 2), np.float32)
        filled[:, :count], filled[:, count:] = points, points[:, -1:]
        # A piece ends in the point where the next block begins.
        inner = filled[:, :-1].reshape(lines, blocks, BLOCK, 2)
        after = filled[:, BLOCK::BLOCK]
        low, high = np.minimum(inner.min(axis=2), after), np.maximum(inner.max(axis=2), after)
        # Blocks of nothing but the last point again are out of reach: the one before has that point.
        empty = (low == high).all(axis=-1)
        empty[:, 0] = False
        low[empty], high[empty] = np.inf, -np.inf
        boxes, told = np.concatenate([low, high], axis=-1), np.asarray(sizes, np.float32)
        # One way to the device for all.
        flat = torch.from_numpy(np.concatenate([filled.ravel(), boxes.ravel(), told.ravel()])).to(self._device)
        of_points, of_boxes, of_sizes = flat.split([filled.size, boxes.size, told.size])
        return PlacedChains(of_points.view(filled.shape), of_boxes.view(boxes.shape), of_sizes.view(-1, 2), count)

    def parts(self, chains: PlacedChains) -> torch.Tensor:
        """Each line alone [m], shape [L, n, n], float32."""
        return self._printed(chains, 1)[..., 0]

    def alone(self, chains: PlacedChains) -> torch.Tensor:
        """Each line alone as it tells what is printed of all: :meth:`parts` where lines add up, else points of cells.

        Those have the shape [L, n, n, supersampling^2] [m].
        """
        if self.model.shape.overlap == 1:
            return self.parts(chains)
        return self._printed(chains, self.model.supersampling**2)

    def together(self, alone: torch.Tensor) -> torch.Tensor:
        """Relief of all together [m], shape [n, n], float32."""
        return relief_of(alone, self.model.shape.overlap)

    def heights(self, points: FloatArray, sizes: FloatArray) -> torch.Tensor:
        """Relief of all together [m], shape [n, n], float32."""
        return self.together(self.alone(self.placed(points, sizes)))

    def _printed(self, chains: PlacedChains, count: int) -> torch.Tensor:
        """Each line alone [m], shape [L, n, n, count], in means of cells or at their points."""
        n = self.model.n
        heights = torch.empty(len(chains), n, n, count, device=self._device)
        if len(chains):
            self._launch(chain_heights, chains, [], [warp_array(heights)])
        return heights.to(self.model.device)

    def gradient(
        self, chains: PlacedChains, alone: torch.Tensor, by_height: torch.Tensor
    ) -> tuple[FloatArray, FloatArray]:
        """Of a function of the relief of all together, by points, shape [L, K, 2], and sizes, shape [L, 2].

        Args:
            chains: lines.
            alone: of these lines, of :meth:`alone` or :meth:`parts`.
            by_height: the function's gradient by the relief [1/m], shape [n, n].
        """
        return self.gradient_of_each(chains, by_each(by_height, alone, self.model.shape.overlap))

    def gradient_of_each(self, chains: PlacedChains, by_height: torch.Tensor) -> tuple[FloatArray, FloatArray]:
        """Of functions of the relief of each alone, by points, shape [L, K, 2], and sizes, shape [L, 2]; float64.

        Args:
            chains: lines.
            by_height: gradients by the reliefs [1/m], shape [L, n, n], or by points of cells.
        """
        of_each, points = by_height.to(self._device).contiguous(), chains.points
        if of_each.ndim == 3:
            of_each = of_each[..., None]
        summed = torch.zeros(points.numel() + 2 * len(chains), device=self._device)
        by_point, by_size = summed[: points.numel()].view(points.shape), summed[points.numel() :].view(-1, 2)
        self._launch(chain_heights_adjoint, chains, [warp_array(of_each)], [warp_array(by_point), warp_array(by_size)])
        # One way back for both. What was filled up repeats the last point.
        found = summed.cpu().numpy().astype(np.float64)
        of_points, of_sizes = found[: points.numel()].reshape(points.shape), found[points.numel() :].reshape(-1, 2)
        told = of_points[:, : chains.count].copy()
        told[:, -1] += of_points[:, chains.count :].sum(axis=1)
        return told, of_sizes

    def _launch(self, kernel: wp.Kernel, chains: PlacedChains, inputs: list[Any], outputs: list[Any]) -> None:
        device, model, shape = self._device, self.model, self.model.shape
        section: Any = ChainSection()
        section.exponent, section.parabola, section.edge = shape.exponent, shape.parabola, section_edge(shape)
        section.is_cap = shape.is_cap
        told = [*map(warp_array, (chains.points, chains.boxes, chains.sizes)), section]
        told += [wp.vec2(*model.scene.sample_pitch_m), model.n, model.supersampling]
        with warp_stream(device):
            dim = len(chains), model.n, -(-model.n // TILE)
            wp.launch(kernel, dim=dim, inputs=told + inputs, outputs=outputs, device=wp.device_from_torch(device))
