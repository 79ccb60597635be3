"""Lines with corners and curves fitted to a relief: all together, or each beside others that stay."""

from collections.abc import Sequence

import numpy as np
import scipy  # loads its parts when they are first used
import torch

from warp_caustics.prints.chain_model import ChainModel
from warp_caustics.prints.model import LineModel
from warp_caustics.prints.overlap import share
from warp_caustics.prints.smooth_chains import TrackPoints
from warp_caustics.prints.vectorise.curved_lines import CurvedLines
from warp_caustics.prints.vectorise.side_by_side import descend_side_by_side
from warp_caustics.types import FloatArray

NODE_SCALE_M, WIDTH_SCALE_M, HEIGHT_SCALE_M = 4e-5, 4e-5, 2e-5
"""Changes that change a relief about as much."""
HELD_M = 4e-4
"""Standard deviation of what a node moves [m], which keeps nodes from sliding along their line."""
SKETCHED = 2
"""Points of a cell, each way, that are looked at."""
CONVERGED = 1e-6
PULL = NODE_SCALE_M / HELD_M


class CurvedFit:
    """A relief, and how well lines tell it.

    Args:
        model: of straight lines, with the section and overlap of these.
        relief_m: to be explained, shape [n, n].
        spread_m: how far it may be wrong [m], shape [n, n].
    """

    def __init__(self, model: LineModel, relief_m: torch.Tensor, spread_m: torch.Tensor):
        self.chains = ChainModel(model.sketched(SKETCHED))
        self.model = self.chains.model
        self.relief = relief_m.to(model.device, torch.float32)
        self.spread = spread_m.to(model.device, torch.float32)
        self.sigma = self.spread

    def focus(self, floor_m: float) -> None:
        """Expect residuals of the spread and of ``floor_m``."""
        self.sigma = (self.spread.square() + floor_m**2).sqrt()

    def losses(self, heights: torch.Tensor) -> FloatArray:
        """What reliefs leave, shape [B], of shape [B, n, n] [m]."""
        residual = (heights - self.relief) / self.sigma
        return residual.square().log1p().sum(dim=(-2, -1), dtype=torch.float64).cpu().numpy() / 2

    def loss(self, heights: torch.Tensor) -> float:
        """What a relief leaves, shape [n, n] [m]."""
        return float(self.losses(heights[None])[0])

    def parts(self, lines: CurvedLines) -> torch.Tensor:
        """Each line alone [m], shape [L, n, n]."""
        if not len(lines):
            return torch.zeros(0, self.model.n, self.model.n, device=self.model.device)
        points = TrackPoints(lines.tracks)
        return self.chains.parts(self.chains.placed(points.of(points.nodes_m), lines.sizes))

    def moved(self, lines: CurvedLines, others_m: torch.Tensor | None, iterations: int) -> CurvedLines:
        """Lines fitted to the relief together, with others [m], shape [n, n], that stay."""
        points = TrackPoints(lines.tracks)
        begun, count = points.nodes_m, 2 * len(points.nodes_m)
        scales = _size_scales(len(lines))
        model = self.model

        def numbers(u: FloatArray) -> tuple[FloatArray, FloatArray]:
            nodes = begun + NODE_SCALE_M * u[:count].reshape(-1, 2)
            return nodes, lines.sizes + scales * u[count:].reshape(-1, 2)

        def objective(u: FloatArray) -> tuple[float, FloatArray]:
            nodes, sizes = numbers(u)
            chains = self.chains.placed(points.of(nodes), sizes)
            parts = self.chains.parts(chains)
            heights = model.joined(parts)
            if others_m is not None:
                heights = model.over(heights, others_m)
            loss, by_height = self._judged(heights[None])
            by_all = by_height[0]
            if others_m is not None and model.shape.overlap != 1:
                by_all = by_all * share(model.joined(parts), heights, model.shape.overlap)
            by_point, by_size = self.chains.gradient(chains, parts, by_all)
            held = PULL * u[:count]
            by_node = NODE_SCALE_M * points.back(by_point).ravel() + PULL * held
            return float(loss[0]) + float(held @ held) / 2, np.concatenate([by_node, (by_size * scales).ravel()])

        low, high = self._ends(lines.sizes, scales)
        ends = [(None, None)] * count + list(zip(low.ravel(), high.ravel(), strict=True))
        settings = {"maxiter": iterations, "maxfun": int(1.3 * iterations) + 2, "maxcor": 20, "ftol": CONVERGED}
        start = np.zeros(count + 2 * len(lines))
        found = scipy.optimize.minimize(objective, start, jac=True, method="L-BFGS-B", bounds=ends, options=settings)
        nodes, sizes = numbers(found.x)
        return CurvedLines(points.tracks_at(nodes), sizes)

    def moved_each(self, lines: Sequence[CurvedLines], others_m: torch.Tensor, iterations: int) -> list[CurvedLines]:
        """Single lines, each fitted to the relief by itself, with others [m], shape [n, n], that stay."""
        if not lines:
            return []
        points = TrackPoints([each.tracks[0] for each in lines])
        sizes, scales = np.concatenate([each.sizes for each in lines]), _size_scales(len(lines))
        counts = np.array([len(track.nodes_m) for track in points.tracks])
        begun, most = points.nodes_m, 2 * int(counts.max())
        used = np.arange(most // 2) < counts[:, None]

        def numbers(u: FloatArray) -> tuple[FloatArray, FloatArray]:
            return begun + NODE_SCALE_M * u[:, :most].reshape(len(lines), -1, 2)[used], sizes + scales * u[:, most:]

        def objective(u: FloatArray) -> tuple[FloatArray, FloatArray]:
            nodes, moved = numbers(u)
            chains = self.chains.placed(points.of(nodes), moved)
            parts = self.chains.parts(chains)
            heights = self.model.over(parts, others_m)
            losses, by_height = self._judged(heights)
            if self.model.shape.overlap != 1:
                by_height = by_height * share(parts, heights, self.model.shape.overlap)
            by_point, by_size = self.chains.gradient_of_each(chains, by_height)
            by_node = np.zeros((len(lines), most // 2, 2))
            by_node[used] = NODE_SCALE_M * points.back(by_point)
            held = PULL * u[:, :most]
            gradient = np.concatenate([by_node.reshape(len(lines), -1) + PULL * held, by_size * scales], axis=1)
            return losses + (held**2).sum(axis=1) / 2, gradient

        low, high = self._ends(sizes, scales)
        free = np.full((len(lines), most), np.inf)
        found = descend_side_by_side(
            objective,
            np.zeros((len(lines), most + 2)),
            np.concatenate([-free, low], axis=1),
            np.concatenate([free, high], axis=1),
            iterations=iterations,
            converged=CONVERGED,
        )
        nodes, moved = numbers(found.numbers)
        return [CurvedLines([track], size[None]) for track, size in zip(points.tracks_at(nodes), moved, strict=True)]

    def _judged(self, heights: torch.Tensor) -> tuple[FloatArray, torch.Tensor]:
        """Losses of reliefs [m], shape [B, n, n], and their gradients by these [1/m]."""
        residual = (heights - self.relief) / self.sigma
        square = residual.square()
        losses = square.log1p().sum(dim=(-2, -1), dtype=torch.float64).cpu().numpy() / 2
        return losses, residual / (1 + square) / self.sigma

    def _ends(self, sizes: FloatArray, scales: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Least and largest changes of sizes, shape [L, 2] each, in units of their scales; what is beyond stays."""
        limits = self.model.limits
        low, high = np.array([limits.width_m, limits.height_m]).T
        return np.minimum((low - sizes) / scales, 0.0), np.maximum((high - sizes) / scales, 0.0)


def _size_scales(count: int) -> FloatArray:
    return np.tile([WIDTH_SCALE_M, HEIGHT_SCALE_M], (count, 1))
