"""Lines searched for on an image: descents and jumps in turn on few pixels, then descents on more and on all."""

from collections.abc import Callable

import torch

from data_gen.vectorise.model import LineModel
from nets.reconstruct.fibres.image_fit import ImageFit
from nets.reconstruct.fibres.image_moves import jump
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.scene import Scene

ITERATIONS = 40
"""Of L-BFGS between jumps; half as many on more pixels after a search."""

LAST = 15
"""Iterations on all pixels. They bring six own plates, printed with some noise and seen by a model camera, from errors
of 0.2 to 3.3 um RMS at 256 pixels to 0.1 to 1.6 um at 512, and what is left of the image down to its noise."""

LATER = 6
"""Lines that may jump in rounds after the first."""

FINE_PHOTONS_PER_PIXEL = 8
"""With the four of a usual lattice, wrong lines explain an own field's image at 256 pixels better (0.0038) than the
true ones (0.0050): they fit the lattice. With eight, worse (0.0025 and 0.0020)."""


class LineSearch:
    """A search from lines that are nearly right.

    Args:
        scene: the set-up.
        image: what was measured.
        model: renders lines.
        pixels: size of the image for most of the work; jumps are tried at half as many, where the heights allow it.
        jumps: rounds of jumps, at most; 0 where lines are known to be nearly right.
        iterations: of L-BFGS between jumps.
        report: called after each evaluation with its loss; may raise.
    """

    def __init__(
        self,
        scene: Scene,
        image: CausticImage,
        model: LineModel,
        pixels: int,
        *,
        jumps: int,
        iterations: int = ITERATIONS,
        report: Callable[[float], None] | None = None,
    ):
        self.jumps, self.iterations = jumps, iterations
        self.lines = torch.zeros(0, 6, dtype=torch.float64)
        """The best so far, shape [L, 6] [mm]; stays when ``run`` is interrupted."""

        def fit(size: int) -> ImageFit:
            return ImageFit(scene, image, model, size, photons_per_pixel=FINE_PHOTONS_PER_PIXEL, report=report)

        self.coarse = self.fine = fit(pixels)
        self.last = fit(scene.image_pixels) if pixels < scene.image_pixels else None
        if pixels % 2 == 0 and pixels // 2 >= scene.height_samples:
            self.coarse = ImageFit(scene, image, model, pixels // 2, report=report)

    def run(self, start: torch.Tensor) -> torch.Tensor:
        """Lines that explain the image better, shape [L, 6] [mm].

        Args:
            start: shape [L, 6] [mm], float64.
        """
        # Losses at few and at many pixels do not compare: what is best at few is some micrometres off at many.
        if self.jumps:
            self.lines = self.fine.descend(self._searched(start), self.iterations // 2).lines
        else:
            self.lines = self.fine.descend(start, self.iterations).lines
        if self.last is not None:
            self.lines = self.last.descend(self.lines, min(LAST, self.iterations)).lines
        return self.lines

    def _searched(self, start: torch.Tensor) -> torch.Tensor:
        """After descents and jumps in turn: few pixels tell which lines there are, for a quarter of the time."""
        best = self.coarse.descend(start, self.iterations)
        self.lines = best.lines
        for number in range(self.jumps):
            moved, has_jumped = jump(self.coarse, best.lines, LATER if number else None)
            if not has_jumped:
                break
            found = self.coarse.descend(moved, self.iterations)
            if found.loss >= best.loss:
                break
            best, self.lines = found, found.lines
        return best.lines
