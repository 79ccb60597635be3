"""How sure the found numbers are: what noise leaves, enlarged by what the residuals really are.

Noise alone leaves H^-1, with H the information of data and priors. Where residuals are larger than their noise, or hang
together over many pixels, different parts of the image say different things. Their scatter gives the sandwich

    S = H^-1 (B / (B - 1) sum_b g_b g_b^T + 1) H^-1,     g_b the pull of block b, less the mean

(Huber, 1967; Cameron and Miller, A practitioner's guide to cluster-robust inference, 2015, eq. 10, with the prior's
unit
information). Of each number the larger deviation of both is told. The simulation itself errs: finer pixels and more
light paths would move the
numbers by d = H^-1 J^T W (change of the images), and d d^T is added, as if that were not known to either side.
"""

from typing import NamedTuple

import torch


class Posterior(NamedTuple):
    """Spread of coordinates, in prior widths.

    Attributes:
        covariance: told, shape [P, P].
        noise_covariance: what noise alone leaves, shape [P, P].
        inflation: by how much residuals enlarge each deviation, at least 1, shape [P].
        numerical: by how much a finer simulation would move each number, shape [P].
    """

    covariance: torch.Tensor
    noise_covariance: torch.Tensor
    inflation: torch.Tensor
    numerical: torch.Tensor


def posterior(information: torch.Tensor, scores: torch.Tensor, pull: torch.Tensor) -> Posterior:
    """The spread at the end of a descent.

    Args:
        information: of data and priors, shape [P, P].
        scores: pulls of blocks, shape [B, P].
        pull: of what a finer simulation shows beside the one that was fitted, shape [P].
    """
    scale = information.diagonal().rsqrt()
    inverse = torch.linalg.inv(information * scale[:, None] * scale) * scale[:, None] * scale
    inverse = (inverse + inverse.T) / 2
    count, numerical = len(scores), inverse @ pull
    apart = scores - scores.mean(0)
    meat = apart.T @ apart * (count / (count - 1)) + torch.eye(len(inverse), dtype=torch.float64)
    sandwich = inverse @ meat @ inverse
    inflation = (sandwich.diagonal() / inverse.diagonal()).clamp_min(1.0).sqrt()
    told = inverse * inflation[:, None] * inflation + numerical[:, None] * numerical
    return Posterior(told, inverse, inflation, numerical)
