"""Noise of pixels: what the camera's own is, and what is left besides, fitted to residuals.

    sigma^2 = a s^2 + b s^2 I / L + c |grad I|^2 + d I^2 [W^2/m^4]

with s the noise of flat light: reading, shot noise, structure that lies a fraction of a pixel beside its place, and
speckle. What a model lacks mostly looks like one of the last two, and then counts less where it matters most.
"""

import numpy as np
import scipy  # loads its parts when they are first used
import torch

from warp_caustics.errors import InputError

READ_SHARE = 0.3
"""Of the variance of flat light that is taken for reading before anything is known."""
FIRST_MISPLACED_PX = 0.1
FIRST_SPECKLE = 0.02
"""Before residuals are known [1]: they keep caustic lines from deciding alone."""
CLIP = 3.0
"""Standard deviations at which residuals are cut for the fit; Gaussian ones then keep 0.9908 of their variance."""
KEPT = 0.9908
ROUNDS = 6
LEAST = 0.05
"""Of the camera's noise that no pixel goes below: noise that a file does not have would make it tell everything."""


def terms(image: torch.Tensor, noise: torch.Tensor, level: torch.Tensor) -> torch.Tensor:
    """Variances that each coefficient stands for [W^2/m^4], shape [4, C, H, W].

    Args:
        image: what is expected [W/m^2], shape [C, H, W].
        noise: standard deviation where light is flat [W/m^2], shape [C].
        level: flat light L [W/m^2], shape [C].

    Raises:
        InputError: noise that is not above 0.
    """
    if not bool((noise > 0).all()):
        raise InputError(f"noise {float(noise.min()):g} W/m^2 is not above 0; give the camera's, such as --noise 0.01")
    flat = (noise**2)[:, None, None].expand_as(image)
    light = (image / level[:, None, None]).clamp_min(0.0)
    along_y, along_x = torch.gradient(image, dim=(-2, -1))
    return torch.stack((flat, flat * light, along_x**2 + along_y**2, image**2))


def first_variance(parts: torch.Tensor) -> torch.Tensor:
    """Before residuals are known, shape [C, H, W]."""
    weights = torch.tensor(
        [READ_SHARE, 1 - READ_SHARE, FIRST_MISPLACED_PX**2, FIRST_SPECKLE**2], dtype=parts.dtype, device=parts.device
    )
    result: torch.Tensor = torch.tensordot(weights, parts, 1)
    return result


def fitted_variance(parts: torch.Tensor, residuals: torch.Tensor, counts: torch.Tensor) -> torch.Tensor:
    """Variance that explains residuals, each channel by itself, shape [C, H, W].

    Coefficients are not below 0; squares are cut at :data:`CLIP` deviations, so that grains of dust are none of it.

    Args:
        parts: of :func:`terms`, shape [4, C, H, W].
        residuals: image less model [W/m^2], shape [C, H, W].
        counts: whether a pixel counts, shape [C, H, W], bool.
    """
    found = torch.empty_like(parts[0])
    for channel in range(parts.shape[1]):
        use = counts[channel]
        columns, square = parts[:, channel, use], residuals[channel, use].square()
        scale = columns.mean(1, keepdim=True).clamp_min(1e-300)
        variance = first_variance(columns)
        variance = variance * (square.median() / 0.4549 / variance.median().clamp_min(1e-300)).clamp_min(1e-12)
        least, solution = LEAST**2 * columns[0], torch.zeros_like(scale)
        for _ in range(ROUNDS):
            cut = torch.minimum(square, CLIP**2 * variance) / KEPT
            weighted = columns / scale / variance
            normal, right = (weighted @ weighted.T).cpu().numpy(), (weighted @ (cut / variance)).cpu().numpy()
            factor = np.linalg.cholesky(normal + 1e-9 * np.trace(normal) * np.eye(4))
            amounts, _ = scipy.optimize.nnls(factor.T, np.linalg.solve(factor, right))
            solution = torch.from_numpy(amounts).to(scale)[:, None] / scale
            variance = torch.maximum((solution * columns).sum(0), least)
        whole = torch.tensordot(solution[:, 0], parts[:, channel], 1)
        found[channel] = torch.maximum(whole, LEAST**2 * parts[0, channel])
    return found
