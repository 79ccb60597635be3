"""Lines of a network's relief, of the section and overlap that tell it best: where the search on the image begins."""

from typing import NamedTuple

import torch

from nets.reconstruct.fibres.image.descent_numbers import reshaped
from nets.reconstruct.fibres.search.section import (
    ELLIPSE,
    OTHER_FACTOR,
    OVERLAPS,
    PARABOLA,
    is_in_vain,
    with_thick_ends,
)
from warp_caustics.prints.fit import fit_lines
from warp_caustics.prints.line_shape import Shape
from warp_caustics.prints.model import LineModel
from warp_caustics.prints.vectorise import LINE_PENALTY, lines_of_relief, unexplained

SHAPES = (Shape(), Shape(0.5), PARABOLA, ELLIPSE, Shape(1.6), Shape(8.0))
"""Cosine, quarter cosine, parabola, ellipse, a bell and nearly a Gaussian: lines found as of one are
fitted anew as of the others, which told the section of seven reliefs of seven for a tenth of the time that finding them
anew takes."""
REFIT_FLOORS_M = (3e-4, 4e-5, 4e-6)
"""Expected size of residuals on bare plate in one fit after the other [m]: lines of another section begin far away."""
REFIT_ITERATIONS = 10
ROUNDS = 2
"""In which sections and overlaps are tried on lines that were found anew."""
WELL_TOLD = 0.025
"""Loss of a sample below which lines tell a relief, and nothing else is tried: cosines of a plate of seven leave
0.019, of one with parabolas 0.135, sums of lines that merge 0.030."""
FAR_FROM_TOLD = 2.0
"""Times that, above which lines are found anew as parabolas though no other section tells those of cosines better:
what was not found as a line of one section tells nothing of another."""
MANY = 15
"""Lines above which they are not found anew where no other section tells them better: so many are far from told by any,
and two dozen take half a minute on a CPU."""


class _Start(NamedTuple):
    """Lines, shape [L, 6] [m], what they leave of the relief, their section and what is printed where they cross."""

    lines: torch.Tensor
    left: float
    shape: Shape


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

    def judged(lines: torch.Tensor) -> _Start:
        return _Start(lines, unexplained(model, lines, relief_m, spread_m), model.shape)

    first = best = judged(lines_of_relief(model, relief_m, spread_m, most=most))
    enough = WELL_TOLD * relief_m.numel() + LINE_PENALTY * len(best.lines)
    if not finds_section or not 2 <= len(best.lines) < most or best.left < enough:
        return best.lines  # of a relief that needs more lines than it may have, none is told by what is left of it
    are_few = len(best.lines) <= MANY

    def anew(start: _Start) -> _Start:
        model.shape = start.shape
        return judged(lines_of_relief(model, relief_m, spread_m, most=most))

    for _ in range(ROUNDS):
        before, left = best, dict[Shape, float]()
        for shape in SHAPES:
            crossed = before.shape.with_section(shape)
            if crossed != before.shape and not is_in_vain(shape, left, before.left):
                model.shape = crossed
                lines = reshaped(before.lines, before.shape, crossed)
                other = judged(_refitted(model, lines, relief_m, spread_m))
                left[shape], best = other.left, _better(best, other)
        told = best
        others = [told.shape._replace(overlap=overlap) for overlap in OVERLAPS if overlap != before.shape.overlap]
        if not told.shape.thicker:
            others.append(with_thick_ends(told.shape))
        for other_shape in others:
            model.shape = other_shape
            best = _better(best, judged(_refitted(model, told.lines, relief_m, spread_m)))
        if best.shape == before.shape:
            break
        best = min(best, anew(best), key=lambda start: start.left)
    if best is first and are_few and best.left > FAR_FROM_TOLD * enough:
        best = _better(best, anew(best._replace(shape=best.shape.with_section(PARABOLA))))
    model.shape = best.shape
    return best.lines


def _better(best: _Start, other: _Start) -> _Start:
    """Another section or overlap where it leaves clearly less."""
    return other if other.left < OTHER_FACTOR * best.left else best


def _refitted(model: LineModel, lines: torch.Tensor, relief_m: torch.Tensor, spread_m: torch.Tensor) -> torch.Tensor:
    """Lines moved to tell a relief as well as the model's section and overlap let them, shape [L, 6] [m]."""
    relief, spread = (values.to(model.device, torch.float32) for values in (relief_m, spread_m))
    lines = model.clamped(lines)
    for floor in REFIT_FLOORS_M:
        sigma = (spread.square() + floor**2).sqrt()
        lines = fit_lines(model, lines, relief, sigma, iterations=REFIT_ITERATIONS)[0]
    return lines
