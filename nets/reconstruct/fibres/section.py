"""The section of all lines, from a few: which exponent g of cos(pi r / w)^(2 g) lets lines explain the image best?

A start for descents, which find it to a percent: the misfit has one valley in g when lines keep their width at half
their height, but from far away a descent of all numbers would rather bend lines than their section.
"""

import math

import torch

from nets.reconstruct.fibres.image_fit import ImageFit
from warp_caustics.prints.model import WIDTH

TRIED_EXPONENTS = (1.0, 0.5, 0.7, 1.4, 0.35, 2.0)
"""The cosine first: another one must explain the image better."""
TRIAL_ITERATIONS = 8
"""Of L-BFGS with each."""
MORE_ITERATIONS = 15
"""Of L-BFGS in which the exponent moves with the best lines."""


def half_height(exponent: float) -> float:
    """t = 2 r / w at which cos(pi t / 2)^(2 g) is one half [1]."""
    return 2 / math.pi * math.acos(0.5 ** (1 / (2 * exponent)))


def reshaped(lines: torch.Tensor, exponent: float, new: float) -> torch.Tensor:
    """Lines of another exponent that are as wide at half their height, shape [L, 6] [m]."""
    changed = lines.clone()
    changed[:, WIDTH] *= half_height(exponent) / half_height(new)
    return changed


def with_section_found(fit: ImageFit, lines: torch.Tensor) -> torch.Tensor:
    """Lines of the exponent that explains the image best, shape [L, 6] [m]; the model has that exponent afterwards.

    Args:
        fit: judges; few pixels will do.
        lines: shape [L, 6] [m].
    """
    model = fit.model
    if not len(lines):
        return lines
    given, best = model.exponent, (math.inf, model.exponent, lines)
    try:
        for tried in TRIED_EXPONENTS:
            model.exponent = tried
            found = fit.descend(model.clamped(reshaped(lines, given, tried)), TRIAL_ITERATIONS)
            if found.loss < best[0]:
                best = (found.loss, tried, found.lines)
    finally:
        model.exponent = best[1]
    return fit.descend(best[2], MORE_ITERATIONS, with_section=True).lines
