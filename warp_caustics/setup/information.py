"""What noise leaves to be known of parameters: Fisher information and all that follows from it.

With independent Gaussian noise of standard deviation sigma the information is F = J diag(1 / sigma^2) J^T, and no
unbiased estimate scatters less than the Cramer-Rao bound, the diagonal of F^-1 (Kay, Fundamentals of Statistical Signal
Processing: Estimation Theory, 1993, sections 3.7 and 3.9). With what is known before, a Gaussian of widths w, F +
diag(1 / w^2) takes its place: the van Trees bound.
"""

from typing import NamedTuple

import torch

from warp_caustics.errors import InputError

NULL = 1e-12
"""Eigenvalues of the information with a diagonal of ones below this are 0: rounding leaves more."""


def fisher_information(jacobian: torch.Tensor, noise: torch.Tensor | float) -> torch.Tensor:
    """F [1 / units of two parameters], shape [P, P], float64, on the CPU.

    Args:
        jacobian: derivatives of an image by parameters [W/m^2 per unit], shape [P, ...].
        noise: standard deviation of each pixel [W/m^2]: a number, or of a shape that goes with an image's.

    Raises:
        InputError: noise that is not above 0 and finite, or of another shape; derivatives that are not finite.
    """
    flat = jacobian.detach().to(torch.float64).flatten(1)
    sigma = torch.as_tensor(noise, dtype=torch.float64, device=flat.device)
    if not bool((torch.isfinite(sigma) & (sigma > 0)).all()):
        worst = float(sigma.nan_to_num(nan=-1.0).min())
        raise InputError(
            f"noise {worst:g} W/m^2 is not above 0 and finite: without noise an image tells everything; give the "
            "camera's, for example 0.01"
        )
    if not bool(torch.isfinite(flat).all()):
        raise InputError("derivatives are not finite; look for light that is totally reflected")
    try:
        sigma = sigma.expand(jacobian.shape[1:])
    except RuntimeError:
        raise InputError(
            f"noise has shape {list(sigma.shape)}, an image {list(jacobian.shape[1:])}; give one for all or one each"
        ) from None
    weighted = flat / sigma.reshape(1, -1)
    return (weighted @ weighted.T).cpu()


def with_priors(information: torch.Tensor, priors: torch.Tensor) -> torch.Tensor:
    """Information of image and prior knowledge together, F + diag(1 / w^2), shape [P, P].

    Args:
        information: F, shape [P, P].
        priors: widths w, shape [P]; infinite where nothing is known.

    Raises:
        InputError: a width that is not above 0.
    """
    if not bool((priors > 0).all()):
        raise InputError(f"prior width {float(priors.min()):g} is not above 0; leave out what is known exactly")
    return information + torch.diag(priors.to(torch.float64) ** -2)


def covariance(information: torch.Tensor) -> torch.Tensor:
    """F^-1, shape [P, P].

    Parameters that take part in a combination of which there is no information have infinity on the diagonal, and NaN
    in the rest of their rows and columns.
    """
    diagonal = information.diagonal()
    told = diagonal > 0
    scale = torch.where(told, diagonal, 1.0).rsqrt()
    values, vectors = torch.linalg.eigh(information * scale[:, None] * scale)
    is_null = values <= NULL * len(values)
    inverse = torch.where(is_null, 0.0, 1 / values.clamp_min(NULL * 1e-3))
    result: torch.Tensor = (vectors * inverse) @ vectors.T * scale[:, None] * scale
    lost = ~told | ((vectors[:, is_null] ** 2).sum(1) > 1e-6)
    result[lost, :] = torch.nan
    result[:, lost] = torch.nan
    result[lost, lost] = torch.inf
    return result


def marginal_deviations(information: torch.Tensor) -> torch.Tensor:
    """Least standard deviation of each parameter while all others are unknown, too, shape [P]; infinite if not told."""
    return covariance(information).diagonal().sqrt()


def conditional_deviations(information: torch.Tensor) -> torch.Tensor:
    """The same while all others are known, 1 / sqrt(F_ii), shape [P]."""
    return information.diagonal().rsqrt()


def correlations(information: torch.Tensor) -> torch.Tensor:
    """Correlation of what estimates of two parameters err by, shape [P, P]; NaN where one is not determined."""
    found = covariance(information)
    deviation = found.diagonal().sqrt()
    return found / deviation[:, None] / deviation


def without(information: torch.Tensor, nuisance: torch.Tensor) -> torch.Tensor:
    """Information of the other parameters once nuisance parameters are estimated along: the Schur complement.

    Args:
        information: shape [P, P].
        nuisance: which are not asked for, shape [P], bool; theirs must have full rank, as with priors.

    Returns:
        Shape [Q, Q] of the Q others.

    Raises:
        InputError: nuisance parameters that nothing determines.
    """
    keep = ~nuisance
    own, mixed = information[nuisance][:, nuisance], information[nuisance][:, keep]
    kept = information[keep][:, keep]
    if not len(own):
        return kept
    scale = own.diagonal().clamp_min(torch.finfo(torch.float64).tiny).rsqrt()
    factor, failed = torch.linalg.cholesky_ex(own * scale[:, None] * scale)
    if int(failed):
        raise InputError("nuisance parameters are not determined by image and priors; give each a prior width")
    half = torch.linalg.solve_triangular(factor, scale[:, None] * mixed, upper=False)
    left: torch.Tensor = kept - half.T @ half
    return left


class Direction(NamedTuple):
    """A combination of parameters about which an image tells as much as about no other at right angles to it.

    Attributes:
        remaining: what the image leaves of its prior width [1].
        weights: of the parameters, each in units of its prior width, shape [P]; unit length, the largest above 0.
    """

    remaining: float
    weights: torch.Tensor


def directions(information: torch.Tensor, priors: torch.Tensor) -> list[Direction]:
    """Eigenvectors of the information in units of prior widths, best determined first.

    Args:
        information: of the image alone, shape [P, P].
        priors: widths, shape [P], finite.
    """
    values, vectors = torch.linalg.eigh(information * priors[:, None] * priors)
    found = []
    for value, vector in zip(values.flip(0).tolist(), vectors.T.flip(0), strict=True):
        sign = 1.0 if float(vector[vector.abs().argmax()]) > 0 else -1.0
        found.append(Direction((1 + max(value, 0.0)) ** -0.5, sign * vector))
    return found
