"""Images shifted, magnified and blurred: one product with banded matrices along x and one along y."""

import math

import numpy as np
import scipy.ndimage
import torch

from warp_caustics.reconstruct.base import CausticImage, FloatArray
from warp_caustics.reconstruct.channel_camera import ChannelCamera

LANCZOS = 4
"""Half width of the interpolating kernel [px]: eight taps, which shift without softening."""
BLUR_REACH = 4.0
"""Where a blur is cut, in standard deviations."""
FREQUENCIES = 256
"""At which the transfer function of a blur is sampled."""
SPOILED = 0.1
"""Share of a resampled pixel that may come from pixels that do not count."""
_NEIGHBOURS = 5
"""Size of the square that stands in for pixels that do not count."""


def resampling_matrix(pixels: int, shift: float, scale: float) -> torch.Tensor:
    """Rows that give each output pixel as a weighted sum of input pixels, shape [m, m], float64; each sums to 1.

    Beyond its border a picture goes on as at the border.

    Args:
        pixels: m.
        shift: of the picture towards larger coordinates [px].
        scale: magnification about the middle, less 1.
    """
    middle = (pixels - 1) / 2
    row = torch.arange(pixels, dtype=torch.float64)
    source = middle + (row - middle - shift) / (1 + scale)
    first = source.floor()
    near = torch.arange(1 - LANCZOS, LANCZOS + 1, dtype=torch.float64)
    distance = (source - first)[:, None] - near
    weights = torch.sinc(distance) * torch.sinc(distance / LANCZOS)
    weights = weights / weights.sum(dim=-1, keepdim=True)
    column = (first[:, None] + near).clamp(0, pixels - 1).long()
    return torch.zeros(pixels, pixels, dtype=torch.float64).scatter_add_(-1, column, weights)


def blur_matrix(pixels: int, blur: float) -> torch.Tensor:
    """Gaussian blur along one axis, shape [m, m], float64: symmetric, so its own adjoint; rows and columns sum to 1.

    From its transfer function within the pixels' band: sampled in space, a Gaussian far below a pixel would not blur
    at all. At the border the picture is mirrored, which keeps all light and the matrix symmetric.

    Args:
        pixels: m.
        blur: standard deviation [px]; 0 gives the identity.
    """
    if blur == 0:
        return torch.eye(pixels, dtype=torch.float64)
    reach = max(4, math.ceil(BLUR_REACH * blur))
    omega = (torch.arange(FREQUENCIES, dtype=torch.float64) + 0.5) * (math.pi / FREQUENCIES)
    offset = torch.arange(-reach, reach + 1)
    kernel = torch.exp(-0.5 * (blur * omega) ** 2) @ torch.cos(omega[:, None] * offset) / FREQUENCIES
    kernel = kernel / kernel.sum()
    column = torch.remainder(torch.arange(pixels)[:, None] + offset, 2 * pixels)
    column = torch.minimum(column, 2 * pixels - 1 - column)
    matrix = torch.zeros(pixels, pixels, dtype=torch.float64)
    return matrix.scatter_add_(1, column, kernel.expand(pixels, -1))


def blur_matrices(pixels: int, blur: FloatArray, device: torch.device | str) -> torch.Tensor:
    """Of all channels, shape [n_w, m, m], float32; for :func:`blurred`.

    Args:
        pixels: m.
        blur: standard deviation [px], shape [n_w].
        device: where to put them.
    """
    known = {value: blur_matrix(pixels, value) for value in {float(value) for value in blur}}
    return torch.stack([known[float(value)] for value in blur]).to(device, torch.float32)


def blurred(image: torch.Tensor, matrices: torch.Tensor) -> torch.Tensor:
    """An image through :func:`blur_matrices`, both of shape [n_w, m, m]; differentiable."""
    return matrices @ image @ matrices


def repaired(image: CausticImage) -> FloatArray:
    """Irradiance [n_w, m, m] whose pixels that do not count take the mean of their neighbours that do.

    Or stay, if brighter: saturated ones tell the least of what was there.
    """
    values = np.asarray(image.irradiance, dtype=np.float64)
    if image.mask is None or image.mask.all():
        return values
    counts, size = image.mask.astype(np.float64), (1, _NEIGHBOURS, _NEIGHBOURS)
    weight = scipy.ndimage.uniform_filter(counts, size)
    mean = scipy.ndimage.uniform_filter(values * counts, size) / np.maximum(weight, 1e-9)
    return np.where(image.mask, values, np.maximum(values, mean))


def channels_together(image: CausticImage, camera: ChannelCamera, device: torch.device | str) -> CausticImage:
    """The image with all channels where the middle one lies; blur and noise stay.

    Args:
        image: what the camera saw.
        camera: how far channels are apart.
        device: where to compute.
    """
    values, mask = repaired(image), image.mask
    irradiance = np.array(values)
    kept = None if mask is None else mask.copy()
    pixels = values.shape[-1]
    for channel, ((x, y), scale) in enumerate(zip(camera.shift, camera.scale, strict=True)):
        if x == y == scale == 0:
            continue
        back = 1 / (1 + scale) - 1
        along_x, along_y = (resampling_matrix(pixels, -d / (1 + scale), back).to(device) for d in (x, y))
        picture = torch.as_tensor(values[channel], device=device)
        irradiance[channel] = (along_y @ picture @ along_x.T).cpu().numpy()
        if kept is not None and mask is not None:
            gaps = torch.as_tensor(~mask[channel], dtype=torch.float64, device=device)
            kept[channel] = (along_y.abs() @ gaps @ along_x.abs().T < SPOILED).cpu().numpy()
    return CausticImage(irradiance, image.noise_std, kept)
