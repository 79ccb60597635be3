"""How sure the found numbers are: what noise leaves, enlarged by what the residuals really are.

Noise alone leaves H^-1, with H the information of data and priors. Where residuals are larger than their noise, or hang
together over many pixels, different parts of the image say different things. Their scatter gives the sandwich

    S = H^-1 (B / (B - 1) sum_b g_b g_b^T + 1) H^-1,     g_b the pull of block b, less the mean

(Huber, 1967; Cameron and Miller, A practitioner's guide to cluster-robust inference, 2015, eq. 10, with the prior's
unit
information). Of each number the larger deviation of both is told, and correlations are those of noise.
"""

from typing import NamedTuple

import torch


class Posterior(NamedTuple):
    """Spread of coordinates, in prior widths.

    Attributes:
        covariance: told, shape [P, P].
        noise_covariance: what noise alone leaves, shape [P, P].
        inflation: by how much residuals enlarge each deviation, at least 1, shape [P].
    """

    covariance: torch.Tensor
    noise_covariance: torch.Tensor
    inflation: torch.Tensor


def posterior(information: torch.Tensor, scores: torch.Tensor) -> Posterior:
    """The spread at the end of a descent.

    Args:
        information: of data and priors, shape [P, P].
        scores: pulls of blocks, shape [B, P].
    """
    scale = information.diagonal().rsqrt()
    inverse = torch.linalg.inv(information * scale[:, None] * scale) * scale[:, None] * scale
    inverse = (inverse + inverse.T) / 2
    count = len(scores)
    if count < 2:
        return Posterior(inverse, inverse, torch.ones(len(inverse), dtype=torch.float64))
    apart = scores - scores.mean(0)
    meat = apart.T @ apart * (count / (count - 1)) + torch.eye(len(inverse), dtype=torch.float64)
    sandwich = inverse @ meat @ inverse
    inflation = (sandwich.diagonal() / inverse.diagonal()).clamp_min(1.0).sqrt()
    return Posterior(inverse * inflation[:, None] * inflation, inverse, inflation)
