"""Lines with corners and curves fitted to an image: all nodes, widths and heights at once, and their section."""

import numpy as np
import scipy  # loads its parts when they are first used
import torch

from nets.reconstruct.fibres.image.descent import LOSS_SCALE
from nets.reconstruct.fibres.image.descent_numbers import SECTION, STEPS, numbers_of, shape_of
from nets.reconstruct.fibres.image.image_fit import ImageFit
from warp_caustics.prints.chain_model import ChainModel
from warp_caustics.prints.line_shape import COSINE_HALF, Shape, half_height
from warp_caustics.prints.smooth_chains import TrackPoints
from warp_caustics.prints.vectorise.curved_lines import CurvedLines
from warp_caustics.types import FloatArray

NODE_SCALE_M, WIDTH_SCALE_M, HEIGHT_SCALE_M, SHAPE_SCALE = 1.5e-5, 2e-5, 5e-6, 5e-3
"""Changes that change an image about as much."""
HELD_M = 3e-4
"""Standard deviation of what a node moves [m]: it keeps nodes from sliding along their line, which changes nothing."""
TOGETHER_PX = 5.0
"""Pixels that err together: so many times less do they tell than if they were independent."""
CONVERGED = 1e-5


def curved_heights(model: ChainModel, lines: CurvedLines) -> torch.Tensor:
    """Relief of lines [m], shape [n, n], float32."""
    points = TrackPoints(lines.tracks)
    return model.heights(points.of(points.nodes_m), lines.sizes)


def fitted_to_image(
    fit: ImageFit, start: CurvedLines, iterations: int, noise: float, *, with_section: bool = False
) -> tuple[CurvedLines, float]:
    """Lines that explain an image better, and their misfit; never worse.

    Args:
        fit: judges.
        start: where to begin.
        iterations: of L-BFGS, at most.
        noise: standard deviation of a pixel, in units of the radiosity.
        with_section: the model's section is found with them, and left at its best.
    """
    descent = _Descent(fit, start, noise, with_section)
    settings = {"maxiter": iterations, "maxfun": int(1.3 * iterations) + 2, "maxcor": 30, "ftol": CONVERGED}
    about = {"jac": True, "method": "L-BFGS-B", "bounds": descent.bounds(), "options": settings}
    try:
        scipy.optimize.minimize(descent, np.zeros(descent.size), **about)
    finally:
        fit.model.shape = descent.shape
    return descent.best, descent.loss


class _Descent:
    """A descent so far: what it is at is a change from where it began, in units of the scales above.

    Attributes:
        best: lines with the least misfit.
        loss: that misfit.
        shape: of the model with these.
    """

    def __init__(self, fit: ImageFit, start: CurvedLines, noise: float, with_section: bool):
        self.fit, self.chains, self.points, self.start = fit, ChainModel(fit.model), TrackPoints(start.tracks), start
        self.best, self.loss, self.shape = start, np.inf, fit.model.shape
        self._nodes = self.points.nodes_m
        self._begun = numbers_of(fit.model.shape)
        self._of_shape = SECTION if with_section and not fit.model.shape.is_cap else ()
        self._scales = np.tile([WIDTH_SCALE_M, HEIGHT_SCALE_M], (len(start), 1))
        self.size = self._nodes.size + self._scales.size + len(self._of_shape)
        # The misfit is r^2 / (2 width) for each pixel's residual, their mean; noise says r^2 / (2 noise^2), their sum.
        pixels = float(fit.measurement.weight.sum())
        self._believed = LOSS_SCALE * TOGETHER_PX * noise**2 / (fit.width * pixels)

    def bounds(self) -> list[tuple[float | None, float | None]]:
        """Of the numbers."""
        limits, found = self.fit.model.limits, list[tuple[float | None, float | None]]()
        found += [(None, None)] * self._nodes.size
        narrower = half_height(self.fit.model.shape) / COSINE_HALF
        for width, height in self.start.sizes:
            for at, scale, (low, high), factor in (
                (width, WIDTH_SCALE_M, limits.width_m, narrower),
                (height, HEIGHT_SCALE_M, limits.height_m, 1.0),
            ):
                ends = ((end / factor - at) / scale for end in (low, high))
                found.append((min(next(ends), 0.0), max(next(ends), 0.0)))
        return found + [(None, None)] * len(self._of_shape)

    def _numbers(self, u: FloatArray) -> tuple[FloatArray, FloatArray, Shape]:
        """Nodes [m], shape [N, 2], sizes [m], shape [L, 2], and the shape of the model."""
        nodes = self._nodes.size
        sizes = nodes + self._scales.size
        shape = self.shape_at(u[sizes:])
        moved = self.start.sizes + self._scales * u[nodes:sizes].reshape(-1, 2)
        return self._nodes + NODE_SCALE_M * u[:nodes].reshape(-1, 2), moved, shape

    def shape_at(self, u: FloatArray) -> Shape:
        """The shape for changes of the section's numbers."""
        moved = list(self._begun)
        for place, change in zip(self._of_shape, u, strict=True):
            moved[place] += SHAPE_SCALE * float(change)
        return shape_of(moved) if self._of_shape else self.fit.model.shape

    def __call__(self, u: FloatArray) -> tuple[float, FloatArray]:
        """Scaled misfit and what is believed of nodes, and the gradient."""
        model = self.fit.model
        nodes, told, shape = self._numbers(u)
        model.shape = shape
        # Lines keep their width at half their height when the section moves.
        sizes = told * [half_height(self._begun_shape) / half_height(shape), 1.0] if self._of_shape else told
        at = self.points.of(nodes)
        chains = self.chains.placed(at, sizes)
        alone = self.chains.alone(chains)
        loss, by_height, _ = self.fit.with_gradient(self.chains.together(alone))
        by_point, by_size = self.chains.gradient(chains, alone, by_height)
        of_sizes = by_size * (sizes / told) * self._scales
        by_shape = self._by_shape(at, sizes, shape, by_height)
        held = NODE_SCALE_M / HELD_M * u[: nodes.size]
        by_node = LOSS_SCALE * NODE_SCALE_M * self.points.back(by_point).ravel()
        by_node += self._believed * NODE_SCALE_M / HELD_M * held
        gradient = np.concatenate([by_node, LOSS_SCALE * of_sizes.ravel(), LOSS_SCALE * by_shape])
        if loss < self.loss:
            self.loss, self.shape = loss, shape
            self.best = CurvedLines(self.points.tracks_at(nodes), sizes)
        if self.fit.report is not None:
            self.fit.report(loss)
        return LOSS_SCALE * loss + self._believed / 2 * float(held @ held), gradient

    @property
    def _begun_shape(self) -> Shape:
        return shape_of(self._begun)

    def _by_shape(self, at: FloatArray, sizes: FloatArray, shape: Shape, by_height: torch.Tensor) -> FloatArray:
        """Gradient by the section's numbers, by differences of reliefs whose lines are as wide at half their height."""
        model, found = self.fit.model, []
        try:
            for place in self._of_shape:
                reached, heights = [], []
                for sign in (-1, 1):
                    moved = list(numbers_of(shape))
                    moved[place] += sign * STEPS[place]
                    model.shape = shape_of(moved)
                    reached.append(numbers_of(model.shape)[place])
                    wider = half_height(shape) / half_height(model.shape)
                    heights.append(self.chains.heights(at, sizes * [wider, 1.0]))
                slope = float((by_height * (heights[1] - heights[0])).sum(dtype=torch.float64))
                found.append(SHAPE_SCALE * slope / (reached[1] - reached[0]))
        finally:
            model.shape = shape
        return np.array(found)
