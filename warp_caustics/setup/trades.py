"""Which parameters an image confuses one with: those that, were they known, would tell it."""

import math

import torch

MOST_PARTNERS = 3
WORTH = 0.7
"""Correlation from which a parameter trades off with others: knowing them would take 30 % off its deviation."""
ENOUGH = 2.0
"""Partners are looked for until knowing them leaves so many times the deviation that knowing everything leaves."""
NEEDED = 0.9
"""A partner whose absence leaves less than the inverse of this more is no partner."""
LEAST = 1e-2
"""Correlation below which the search for partners ends."""


def partners(information: torch.Tensor, k: int) -> list[tuple[int, float]]:
    """Partners of parameter k and correlations of the errors of both, each while those before it are known.

    Greedy: each is the one that would tell most. What turns out not to be needed is left out again.

    Args:
        information: of image and priors, positive definite, shape [P, P].
        k: which parameter.

    Returns:
        At most :data:`MOST_PARTNERS`; none if even together they would not tell much.
    """
    alone = float(information[k, k]) ** -0.5
    start = _deviation(information, k, [])
    found: list[int] = []
    while len(found) < MOST_PARTNERS and _deviation(information, k, found) > ENOUGH * alone:
        related = _related(information, k, found)
        best = int(related.abs().argmax())
        if abs(float(related[best])) < LEAST:
            break
        found.append(best)
    if _deviation(information, k, found) > (1 - WORTH**2) ** 0.5 * start:
        return []
    for other in list(found):
        rest = [i for i in found if i != other]
        if NEEDED * _deviation(information, k, rest) < _deviation(information, k, found):
            found = rest
    return [(i, float(_related(information, k, found[:place])[i])) for place, i in enumerate(found)]


def _deviation(information: torch.Tensor, k: int, known: list[int]) -> float:
    """Standard deviation of parameter k while some are known and the others are not."""
    kept, covariance = _covariance(information, known)
    return math.sqrt(float(covariance[kept.index(k), kept.index(k)]))


def _related(information: torch.Tensor, k: int, known: list[int]) -> torch.Tensor:
    """Correlations of errors with that of parameter k while some are known, shape [P]; 0 for those and itself."""
    kept, covariance = _covariance(information, known)
    deviation = covariance.diagonal().sqrt()
    row = covariance[kept.index(k)] / deviation / deviation[kept.index(k)]
    result = torch.zeros(len(information), dtype=torch.float64)
    result[kept] = row
    result[k] = 0.0
    return result


def _covariance(information: torch.Tensor, known: list[int]) -> tuple[list[int], torch.Tensor]:
    """Numbers of those that are not known, Q of them, and the covariance of their errors, shape [Q, Q]."""
    kept = [i for i in range(len(information)) if i not in known]
    block = information[kept][:, kept]
    scale = block.diagonal().rsqrt()
    return kept, torch.linalg.inv(block * scale[:, None] * scale) * scale[:, None] * scale
