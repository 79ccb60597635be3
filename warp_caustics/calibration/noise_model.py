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
    found = []
    for channel in range(parts.shape[1]):
        use = counts[channel]
        columns = parts[:, channel][:, use].cpu().numpy()
        square = residuals[channel][use].cpu().numpy() ** 2
        scale = np.maximum(columns.mean(1), 1e-300)
        variance = first_variance(parts[:, channel : channel + 1])[0][use].cpu().numpy()
        variance = variance * max(np.median(square) / 0.4549 / max(np.median(variance), 1e-300), 1e-12)
        solution = np.zeros(4)
        for _ in range(ROUNDS):
            cut = np.minimum(square, CLIP**2 * variance) / KEPT
            weighted = columns / scale[:, None] / variance
            normal, right = weighted @ weighted.T, weighted @ (cut / variance)
            factor = np.linalg.cholesky(normal + 1e-9 * np.trace(normal) * np.eye(4))
            solution = scipy.optimize.nnls(factor.T, np.linalg.solve(factor, right))[0] / scale
            variance = np.maximum(solution @ columns, LEAST**2 * columns[0])
        whole = np.tensordot(solution, parts[:, channel].cpu().numpy(), 1)
        found.append(np.maximum(whole, LEAST**2 * parts[0, channel].cpu().numpy()))
    return torch.as_tensor(np.stack(found), dtype=parts.dtype, device=parts.device)
