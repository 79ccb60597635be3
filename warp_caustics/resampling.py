"""Images shifted, magnified and blurred: one product with banded matrices along x and one along y.

Rows of the matrices are a windowed sinc (Lanczos, eight taps), which shifts without softening; it keeps its place to
0.015 px. A blur is a Gaussian given by its transfer function within the pixels' band: sampled in space, one far below
a pixel would not blur at all.
"""

import math

import numpy as np
import numpy.typing as npt
import torch

LANCZOS = 4
"""Half width of the interpolating kernel [px]."""
BLUR_REACH = 4.0
"""Where a blur is cut, in standard deviations."""
LEAST_REACH = 4
"""The same in pixels, at least: a kernel within the pixels' band rings on for some."""
FREQUENCIES = 256
"""At which the transfer function of a blur is sampled."""


def gaussian_kernel(blur: torch.Tensor, reach: int, box: torch.Tensor | None = None) -> torch.Tensor:
    """Gaussian on the pixel grid from -reach to reach, shape [..., 2 reach + 1], of the type of ``blur``; sums to 1.

    Args:
        blur: standard deviation [px], any shape [...].
        reach: where it is cut [px].
        box: width of a square that it is convolved with [px], shape [...]; None for none.
    """
    omega = (torch.arange(FREQUENCIES, device=blur.device) + 0.5).to(blur.dtype) * (math.pi / FREQUENCIES)
    offset = torch.arange(-reach, reach + 1, device=blur.device)
    transfer = torch.exp(-0.5 * (blur[..., None] * omega) ** 2)
    if box is not None:
        transfer = transfer * torch.sinc(box[..., None] * omega / (2 * math.pi))
    kernel = transfer @ torch.cos(omega[:, None] * offset) / FREQUENCIES
    return kernel / kernel.sum(dim=-1, keepdim=True)


def blur_reach(largest: float) -> int:
    """Where a blur of standard deviation ``largest`` [px] is cut [px]."""
    return max(LEAST_REACH, math.ceil(BLUR_REACH * largest))


def resampling_matrix(
    pixels: int, shift: torch.Tensor, scale: torch.Tensor, kernel: torch.Tensor | None = None
) -> torch.Tensor:
    """Rows that give each output pixel as a weighted sum of input pixels, shape [..., m, m]; each sums to 1.

    Beyond its border a picture goes on as at the border.

    Args:
        pixels: m.
        shift: of the picture towards larger coordinates [px], any shape [...]; its type is the result's.
        scale: magnification about the middle, less 1, same shape.
        kernel: of a blur besides, shape [..., 2 r + 1], see :func:`gaussian_kernel`; None for none.
    """
    device, dtype, middle = shift.device, shift.dtype, (pixels - 1) / 2
    row = torch.arange(pixels, device=device, dtype=dtype)
    source = middle + (row - middle - shift[..., None]) / (1 + scale[..., None])  # [..., m]
    first = source.floor()
    near = torch.arange(1 - LANCZOS, LANCZOS + 1, device=device, dtype=dtype)  # [8]
    distance = (source - first)[..., None] - near  # [..., m, 8]
    weights = torch.sinc(distance) * torch.sinc(distance / LANCZOS)
    weights = weights / weights.sum(dim=-1, keepdim=True)
    reach = 0
    if kernel is not None:
        reach = kernel.shape[-1] // 2
        wide = weights.new_zeros(*weights.shape[:-1], 2 * (LANCZOS + reach))
        for k in range(2 * LANCZOS):
            wide[..., k : k + 2 * reach + 1] += weights[..., k : k + 1] * kernel[..., None, :]
        weights = wide
    column = first[..., None] + torch.arange(1 - LANCZOS - reach, LANCZOS + reach + 1, device=device)
    column = column.clamp(0, pixels - 1).long()
    return weights.new_zeros(*weights.shape[:-1], pixels).scatter_add_(-1, column, weights)


def resampled(
    images: torch.Tensor, shift: torch.Tensor, scale: torch.Tensor, blur: torch.Tensor, reach: int
) -> torch.Tensor:
    """Images shifted, magnified about their middle and blurred; beyond its border a picture goes on as at the border.

    Args:
        images: shape [..., m, m].
        shift: towards larger x and y [px], shape [..., 2].
        scale: magnification less 1, shape [...].
        blur: standard deviation [px], shape [...].
        reach: where all blurs are cut [px], see :func:`blur_reach`; a number, so that no device is waited for.
    """
    pixels = images.shape[-1]
    kernel = gaussian_kernel(blur, reach)
    along_x, along_y = (resampling_matrix(pixels, shift[..., axis], scale, kernel) for axis in (0, 1))
    return along_y @ images @ along_x.transpose(-1, -2)


def blur_matrix(pixels: int, blur: float) -> torch.Tensor:
    """Gaussian blur along one axis, shape [m, m], float64: symmetric, so its own adjoint; rows and columns sum to 1.

    At the border the picture is mirrored, which keeps all light and the matrix symmetric.

    Args:
        pixels: m.
        blur: standard deviation [px]; 0 gives the identity.
    """
    if blur == 0:
        return torch.eye(pixels, dtype=torch.float64)
    return mirrored_rows(gaussian_kernel(torch.tensor(blur, dtype=torch.float64), blur_reach(blur)), pixels)


def mirrored_rows(kernel: torch.Tensor, pixels: int) -> torch.Tensor:
    """Matrix that convolves along one axis, mirrored at the border, shape [..., m, m].

    Args:
        kernel: from -reach to reach, shape [..., 2 reach + 1]; a symmetric one gives a symmetric matrix.
        pixels: m.
    """
    reach = kernel.shape[-1] // 2
    offset = torch.arange(-reach, reach + 1, device=kernel.device)
    column = torch.remainder(torch.arange(pixels, device=kernel.device)[:, None] + offset, 2 * pixels)
    column = torch.minimum(column, 2 * pixels - 1 - column).expand(*kernel.shape[:-1], -1, -1)
    matrix = kernel.new_zeros(*kernel.shape[:-1], pixels, pixels)
    return matrix.scatter_add(-1, column, kernel[..., None, :].expand(column.shape))


def blur_matrices(pixels: int, blur: npt.NDArray[np.floating], device: torch.device | str) -> torch.Tensor:
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
