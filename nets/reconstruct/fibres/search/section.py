"""The section of all lines, what is printed where they cross and thicker ends: which lets lines explain the image best?

A start for descents, which find it to a percent: the misfit has one valley in g when lines keep their width at half
their height, but from far away a descent of all numbers would rather bend lines than their section.
"""

import math
from collections.abc import Mapping

import torch

from nets.reconstruct.fibres.image.descent_numbers import reshaped
from nets.reconstruct.fibres.image.image_fit import ImageFit
from warp_caustics.prints.line_shape import Shape

PARABOLA, ELLIPSE, CAP = Shape(1.0, 1.0), Shape(0.5, 1.0), Shape(1.0, 1.0, is_cap=True)
TRIED_SHAPES = (Shape(1.0), Shape(0.5), PARABOLA, ELLIPSE, Shape(1.6), Shape(8.0), Shape(0.35))
"""Cosine, quarter cosine, parabola, ellipse, a bell, nearly a Gaussian, and a box."""
ON_THE_WAY = {Shape(8.0): Shape(1.6), ELLIPSE: PARABOLA, Shape(0.35): Shape(0.5)}
"""To sections that are far from a cosine: not tried where these, which come before them, leave more than what lines
have."""
NEARLY_HIGHEST, HIGHEST = 0.05, 0.0
OVERLAPS = (1.0, 0.35, NEARLY_HIGHEST)
"""Lines add up where they cross, merge as in roots of sums of squares, or nearly, or the highest is nearly printed: one
of these is near enough for descents to find what lies between. The highest itself is tried where it nearly is: q below
0.02 prints the same, which descents see by what 0.02 prints only."""
THICK_ENDS = 0.25, 1e-3
"""That are tried: share, and length [m]."""
TRIAL_ITERATIONS = 8
"""Of L-BFGS with each."""
MORE_ITERATIONS = 15
"""Of L-BFGS in which the section moves with the best lines."""
NEARLY_PARABOLA = 0.5
"""Share of the parabola in a section from which on it may be that of caps, which lie between parabola and ellipse."""
BLUNT = 0.9
"""Power below which it may be, too: caps of single fibres, hardly wider than a sample, were told to the noise by
cosines of a power of 0.36, 0.16 to 0.27 um off, and 0.04 um by caps, which leave a quarter less."""
BELL = 1.1
"""Power from which on a section may be that of a Gaussian that is cut off where it meets the plate."""
ROUND = 0.9
"""Share of the parabola in a section from which on it is none: those cut at one width are half a parabola's."""
STEEP_BELL = 4.0
"""And from which on hardly any of it is cut."""
BELLS = Shape(6.0, cut=0.06), Shape(60.0, cut=0.003)
"""Gaussians whose edge is one width, and one and a half, from the middle; one of these is where a descent begins."""
CUT_FACTOR = 0.997
"""A cut section must lower the misfit by this factor: it has a number more. Feet of 0.2 % of the crown lower that of
two lines by 1 %, and their error from 0.8 to 0.2 um."""
ROUND_OF_COSINE = math.pi**2 / 4
"""Power of the parabola that is as round at its crown as a cosine of the power 1: cos(pi t / 2)^2g is
(1 - t^2)^(g pi^2 / 4) to the second order in t."""
FAMILY_FACTOR = 0.99
"""The other family must lower the misfit by this factor: it did so to 0.2 to 0.35 where it was the plate's, to 0.9 for
quarter cosines, and to 1.000 of twelve lines of a cosine, two of which had gone astray."""
MOVED_FACTOR = 0.6
"""And one that lies between those that are tried, to which a descent goes by itself: twelve lines of a power of 0.77,
which a network had found as cosines, left more than its relief did, and 7 % of that where their section moved. Behind a
base that is thicker than told it would lower it, too, by a little."""
OTHER_FACTOR = 0.96
"""Another section or overlap must lower the misfit by this factor: lines that are wrong explain a little more of
anything with a section of their own."""


def with_thick_ends(shape: Shape) -> Shape:
    """The same with ends that are thicker."""
    thicker, end_m = THICK_ENDS
    return shape._replace(thicker=thicker, end_m=end_m)


def other_family(shape: Shape) -> Shape:
    """Nearly the same section as a power of a parabola; of parabolas as a power of a cosine."""
    is_round = shape.parabola >= NEARLY_PARABOLA
    power = shape.exponent / ROUND_OF_COSINE if is_round else shape.exponent * ROUND_OF_COSINE
    return shape.with_section(Shape(power, 0.0 if is_round else 1.0)).clipped()


def with_other_family(fit: ImageFit, lines: torch.Tensor, iterations: int) -> torch.Tensor:
    """Lines whose section moves, or the like of the other family, shape [L, 6] [m]; the model has what explains more.

    The misfit has a valley along powers of cosines and another along those of parabolas, and a descent stays in the one
    it has begun in: parabolas of a power of 1.2 to 1.5 were told by cosines of 0.5 to 0.6, 2 to 6 um off, which left
    three to five times as much of the image and had lines that are not there make up for it. Of bells other
    things are asked.

    Args:
        fit: judges.
        lines: found with that section, shape [L, 6] [m].
        iterations: of L-BFGS, for each.
    """
    model, given = fit.model, fit.model.shape
    as_cosine = given.exponent / (ROUND_OF_COSINE if given.parabola >= NEARLY_PARABOLA else 1.0)
    if given.is_cap or given.cut or as_cosine >= BELL or not len(lines):
        return lines
    plain, as_found = fit.descend(lines, iterations, with_section=True), model.shape
    model.shape = other_family(as_found)
    other = fit.descend(model.clamped(reshaped(plain.lines, as_found, model.shape)), iterations, with_section=True)
    if other.loss < FAMILY_FACTOR * plain.loss:
        return other.lines
    model.shape = as_found
    return plain.lines


def with_caps(fit: ImageFit, lines: torch.Tensor, iterations: int) -> torch.Tensor:
    """Lines whose section moves, or circular caps, shape [L, 6] [m]; the model has the shape that explains more then.

    Asked of lines whose section has been moved: one with two numbers of its own is nearly a cap, and one that has been
    tried for a few steps only would not tell caps from ellipses, which tall lines have in common. Caps have no number:
    where both descend as long, and caps leave less, they are.

    Args:
        fit: judges.
        lines: found with that section, shape [L, 6] [m].
        iterations: of L-BFGS, for each.
    """
    model, given = fit.model, fit.model.shape
    may_be_caps = given.parabola >= NEARLY_PARABOLA or given.exponent < BLUNT
    if given.is_cap or not may_be_caps or not len(lines):
        return lines
    plain, as_found = fit.descend(lines, iterations, with_section=True), model.shape
    model.shape = given.with_section(CAP)
    caps = fit.descend(model.clamped(reshaped(lines, given, model.shape)), iterations, with_section=True)
    if caps.loss < plain.loss:
        return caps.lines
    model.shape = as_found
    return plain.lines


def with_cut_bells(fit: ImageFit, lines: torch.Tensor, iterations: int) -> torch.Tensor:
    """Lines whose section moves, or cut Gaussians, shape [L, 6] [m]; the model has the shape that explains more then.

    Asked, as caps are, of lines whose section has been moved, to a bell: what is cut off shows in how they meet the
    plate, which is little of an image.

    Args:
        fit: judges.
        lines: found with that section, shape [L, 6] [m].
        iterations: of L-BFGS, for each.
    """
    model, given = fit.model, fit.model.shape
    if given.is_cap or given.cut or given.exponent < BELL or given.parabola > ROUND or not len(lines):
        return lines
    plain, as_found = fit.descend(lines, iterations, with_section=True), model.shape
    bell = BELLS[given.exponent > STEEP_BELL]
    model.shape = given.with_section(bell._replace(exponent=max(bell.exponent, given.exponent)))
    cut = fit.descend(model.clamped(reshaped(lines, given, model.shape)), iterations, with_section=True)
    if cut.loss < CUT_FACTOR * plain.loss:
        return cut.lines
    model.shape = as_found
    return plain.lines


def is_in_vain(shape: Shape, left: Mapping[Shape, float], before: float) -> bool:
    """Whether a section on the way to this one was tried, and left more than what lines had before.

    Args:
        shape: one of those that are tried.
        left: what those left that were.
        before: what the lines' own does.
    """
    way = ON_THE_WAY.get(shape)
    return way is not None and left.get(way, 0.0) > before


def with_section_found(fit: ImageFit, lines: torch.Tensor, *, moves: bool = False) -> tuple[torch.Tensor, bool]:
    """Lines of the section, overlap and ends that explain the image best; the model has these afterwards.

    Args:
        fit: judges; few pixels will do.
        lines: shape [L, 6] [m].
        moves: the section moves with the lines even where none of the others is better: it is not the usual one.

    Returns:
        Lines, shape [L, 6] [m], and whether their section has moved.
    """
    model = fit.model
    if not len(lines):
        return lines, False
    given = best_shape = model.shape
    try:
        best_lines = fit.descend(lines, TRIAL_ITERATIONS)
        least = OTHER_FACTOR * best_lines.loss
        for overlap in OVERLAPS if len(lines) > 1 else ():
            if overlap != given.overlap:
                model.shape = given._replace(overlap=overlap)
                found = fit.descend(lines, TRIAL_ITERATIONS)
                if found.loss < min(least, best_lines.loss):
                    best_lines, best_shape = found, model.shape
        before, least, crossed = best_lines.loss, OTHER_FACTOR * best_lines.loss, best_shape.overlap
        left: dict[Shape, float] = {}
        for shape in TRIED_SHAPES:
            if given.with_section(shape) == given or is_in_vain(shape, left, before):
                continue
            model.shape = given.with_section(shape)._replace(overlap=crossed)
            found = fit.descend(model.clamped(reshaped(lines, given, shape)), TRIAL_ITERATIONS)
            left[shape] = found.loss
            if found.loss < min(least, best_lines.loss):
                best_lines, best_shape = found, model.shape
        if not given.thicker:
            model.shape = with_thick_ends(best_shape)
            found = fit.descend(model.clamped(reshaped(lines, given, best_shape)), TRIAL_ITERATIONS)
            if found.loss < OTHER_FACTOR * best_lines.loss:
                best_lines, best_shape = found, model.shape
        if best_shape == given and not moves:
            model.shape = given
            found = fit.descend(best_lines.lines, TRIAL_ITERATIONS, with_section=True)
            if found.loss < MOVED_FACTOR * best_lines.loss:
                best_lines, best_shape = found, model.shape
    finally:
        model.shape = best_shape
    if best_shape == given and not moves:
        return best_lines.lines, False
    found = fit.descend(best_lines.lines, MORE_ITERATIONS, with_section=True)
    nearly = model.shape
    if 0 < nearly.overlap < 2 * NEARLY_HIGHEST:
        model.shape = nearly._replace(overlap=HIGHEST)
        other = fit.descend(found.lines, MORE_ITERATIONS, with_section=True)
        if other.loss < found.loss:
            return other.lines, True
        model.shape = nearly
    return found.lines, True
