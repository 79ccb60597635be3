"""Speckle: light that interferes with itself on a rough screen, as a factor of mean 1.

Its values are log-normal, near the gamma distribution of a partly developed speckle (Goodman, Speckle Phenomena in
Optics, section 4.5) for contrasts up to 0.3, and its correlation is that of a Gaussian:

    f = exp(s g - s^2 / 2),    s^2 = log(1 + contrast^2),    <g(x) g(x + d)> = exp(-d^2 / (4 w^2)).
"""

import math

import torch

from warp_caustics.resampling import blur_reach, gaussian_kernel


def speckle(
    shape: tuple[int, ...], contrast: float, width_px: float, generator: torch.Generator, dtype: torch.dtype
) -> torch.Tensor:
    """Factors of light, mean 1.

    Args:
        shape: [..., H, W]; images of the leading dimensions are independent.
        contrast: standard deviation over mean.
        width_px: w [px], standard deviation of the Gaussian that white noise is filtered with.
        generator: on the device of the result.
        dtype: of the result.
    """
    device = generator.device
    reach = blur_reach(width_px)
    # Noise that goes on beyond the border is as strong there as inside.
    wide = (*shape[:-2], shape[-2] + 2 * reach, shape[-1] + 2 * reach)
    white = torch.randn(wide, generator=generator, device=device, dtype=dtype)
    kernel = gaussian_kernel(torch.tensor(width_px, dtype=dtype, device=device), reach)
    kernel = kernel / kernel.square().sum().sqrt()
    filtered = torch.nn.functional.conv2d(white.reshape(-1, 1, *wide[-2:]), kernel.reshape(1, 1, 1, -1))
    filtered = torch.nn.functional.conv2d(filtered, kernel.reshape(1, 1, -1, 1)).reshape(shape)
    strength = math.sqrt(math.log1p(contrast**2))
    return torch.exp(strength * filtered - strength**2 / 2)
