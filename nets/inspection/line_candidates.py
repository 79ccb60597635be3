"""Reliefs made of lines, as candidates for a plate: of the design's lines, or of whatever lines a relief has.

Lines are found in a relief by least squares (``warp_caustics.prints.fit_design``; without a design
``warp_caustics.prints.vectorise``), and then fitted to the image (``nets.reconstruct.fibres.search.line_search``).
"""

from collections.abc import Callable, Sequence

import numpy as np
import torch

from nets.reconstruct.fibres.image.lines_view import LinesView
from nets.reconstruct.fibres.search.growth import grown
from nets.reconstruct.fibres.search.line_search import FINAL_ITERATIONS, ITERATIONS, Answer, LineSearch
from nets.reconstruct.fibres.trust.uncertainty import SPREADS
from warp_caustics.inspection.nominal import Nominal
from warp_caustics.prints.fit_design import FittedLine, fit_design
from warp_caustics.prints.line import Line, line_relief
from warp_caustics.prints.model import Limits, LineModel, rows_of
from warp_caustics.prints.vectorise import lines_of_relief
from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray

LOWEST_LINE_M = 2e-5
"""Lines lower than this are missing [m]."""
MOST_EXTRA = 5
"""Lines that nobody designed, at most."""
UNKNOWN_SPREAD_M = 5e-6
"""Taken for the spread of an answer that has none, where lines are looked for in it [m]."""


def limits_around(lines: Sequence[Line], plate_size_m: tuple[float, float]) -> Limits:
    """What a printed line may be: the usual, and half as much again as any line of the design."""
    usual = Limits()
    reaches = [
        2 * abs(x) / size
        for line in lines
        for end in (line.start_m, line.end_m)
        for x, size in zip(end, plate_size_m, strict=True)
    ]
    widths, heights = [line.width_m for line in lines], [line.height_m for line in lines]
    return Limits(
        reach=max([usual.reach, *(reach + 0.08 for reach in reaches)]),
        width_m=(
            min([usual.width_m[0], *(w / 1.5 for w in widths)]),
            max([usual.width_m[1], *(1.5 * w for w in widths)]),
        ),
        height_m=(usual.height_m[0], max([usual.height_m[1], *(1.5 * h for h in heights)])),
    )


class LineCandidates:
    """Lines of one plate.

    Args:
        scene: the set-up of the measurement.
        nominal: the design; where it has no lines, those of a relief are searched for.
        device: where to compute.

    Attributes:
        designed: lines of the design.
        fitted: the same as they were printed, by the latest relief; empty before.
    """

    def __init__(self, scene: Scene, nominal: Nominal, device: torch.device):
        self.scene, self.designed, self.section = scene, nominal.lines, nominal.section
        self.model = LineModel(scene, self.section, device, limits_around(self.designed, scene.plate_size_m))
        self.fitted: tuple[FittedLine, ...] = ()

    def in_relief(self, heights_m: FloatArray, spread_m: FloatArray | None) -> FloatArray:
        """Relief [m], shape [n, n], of the design's lines where a relief has them; notes the lines.

        Args:
            heights_m: the relief [m], shape [n, n].
            spread_m: how far it may be wrong [m], shape [n, n]; None if unknown.
        """
        spread = np.full(heights_m.shape, UNKNOWN_SPREAD_M) if spread_m is None else spread_m
        self.fitted = fit_design(self.model, self.designed, heights_m, spread)
        lines = [fit.line for fit in self.fitted]
        return line_relief(lines, len(heights_m), self.scene.plate_size_m, section=self.section)

    def start(self, heights_m: FloatArray, spread_m: FloatArray | None) -> torch.Tensor:
        """Lines to begin with, shape [L, 6] [m]: of the design as last fitted, or all that a relief has.

        Args:
            heights_m: the relief [m], shape [n, n].
            spread_m: ``SPREADS`` standard deviations of it [m], shape [n, n]; None if unknown.
        """
        if self.designed:
            return rows_of([fit.line for fit in self.fitted if fit.line.height_m > LOWEST_LINE_M])
        heights = torch.as_tensor(heights_m)
        spread = torch.zeros_like(heights) if spread_m is None else torch.as_tensor(spread_m) / SPREADS
        return lines_of_relief(self.model, heights, spread)

    def on_image(
        self,
        start: torch.Tensor,
        view: LinesView,
        pixels: int,
        jumps: int,
        report: Callable[[float], None],
        answer: Answer | None = None,
    ) -> torch.Tensor:
        """Lines that explain the image better, shape [L, 6] [m].

        Where those of a design leave more than noise, some that nobody designed are looked for.

        Args:
            start: lines, shape [L, 6] [m].
            view: what was measured.
            pixels: size of the image for most of the work.
            jumps: rounds of jumps of lines that no design has, at most.
            report: called after each evaluation with its loss; may raise.
            answer: what a network says of the relief, which tells where other lines may be; None asks for none.
        """
        jumps = 0 if self.designed else jumps
        search = LineSearch(view.scene, view.image, self.model, pixels, jumps=jumps, report=report, camera=view.camera)
        lines = search.run(self.model.clamped(start))
        if not self.designed or answer is None or view.is_explained(lines):
            return lines
        more = grown(search.coarse, lines, answer.relief_m, answer.spread_m, len(lines) + MOST_EXTRA).lines
        return search.run(more) if len(more) > len(lines) else lines

    def iterations(self, jumps: int) -> int:
        """Of a fit to the image, about."""
        return ITERATIONS * (1 if self.designed else jumps + 2) + FINAL_ITERATIONS
