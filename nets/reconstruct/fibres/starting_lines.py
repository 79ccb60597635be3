"""Lines of a network's relief, of the section and overlap that tell it best: where the search on the image begins."""

import torch

from nets.reconstruct.fibres.section import OTHER_FACTOR
from warp_caustics.prints.model import LineModel, Overlap, Shape
from warp_caustics.prints.vectorise import LINE_PENALTY, lines_of_relief, unexplained

OTHERS: tuple[tuple[Overlap, Shape | None], ...] = (
    ("sum", Shape(1.0, 1.0)),
    ("sum", Shape(0.5, 1.0)),
    ("max", None),
)
"""Tried after the model's own section: parabola, ellipse, and the best of all merging where lines cross."""
WELL_TOLD = 0.025
"""Loss of a sample below which lines tell a relief, and nothing else is tried: cosines of a plate of seven leave
0.019, of one with parabolas 0.135, sums of lines that merge 0.030."""
MOST_ON_CPU = 15
"""Lines above which a CPU tries nothing else: of two dozen each section takes up to a minute."""


def starting_lines(
    model: LineModel, relief_m: torch.Tensor, spread_m: torch.Tensor, most: int, *, finds_section: bool
) -> torch.Tensor:
    """Lines, shape [L, 6] [m]; the model has their section and overlap afterwards.

    Args:
        model: renders lines.
        relief_m: of the network, shape [n, n] [m].
        spread_m: how far its answers lie apart, shape [n, n] [m].
        most: number of lines at most.
        finds_section: whether other sections and overlaps than the model's are tried.
    """
    start = lines_of_relief(model, relief_m, spread_m, most=most)
    if not finds_section or len(start) < 2 or (model.device.type == "cpu" and len(start) > MOST_ON_CPU):
        return start
    least, best = unexplained(model, start, relief_m, spread_m), (model.shape, model.overlap)
    if least < WELL_TOLD * relief_m.numel() + LINE_PENALTY * len(start):
        return start
    for overlap, shape in OTHERS:
        model.shape, model.overlap = shape or best[0], overlap
        lines = lines_of_relief(model, relief_m, spread_m, most=most)
        left = unexplained(model, lines, relief_m, spread_m)
        if left < OTHER_FACTOR * least:
            start, least, best = lines, left, (model.shape, model.overlap)
    model.shape, model.overlap = best
    return start
