"""Images shifted, magnified and blurred: one product with banded matrices along x and one along y.

Rows of the matrices interpolate by quintic splines, as :mod:`warp_caustics.camera` does, which shifts without softening
and keeps the place of lines. The filter that splines need has the pixels' band as its own, and so has a blur: both are
one kernel, given by the product of their transfer functions. Sampled in space, a blur far below a pixel would not blur
at all.
"""

import math

import numpy as np
import numpy.typing as npt
import torch

from warp_caustics.pixel_spline import TAPS, filter_reach, filter_transfer, mirrored, spline_taps

BLUR_REACH = 4.0
"""Where a blur is cut, in standard deviations."""
LEAST_REACH = 4
"""The same in pixels, at least: a kernel within the pixels' band rings on for some."""
LEAST_SPLINE_REACH, EXACT_SPLINE_REACH = filter_reach(1e-6), filter_reach(1e-13)
"""Where the splines' filter is cut [px]: as exact as float32, and as float64."""
FREQUENCIES = 256
"""At which the transfer function of a blur is sampled."""


def gaussian_kernel(blur: torch.Tensor, reach: int, box: torch.Tensor | None = None) -> torch.Tensor:
    """Gaussian on the pixel grid from -reach to reach, shape [..., 2 reach + 1], of the type of ``blur``; sums to 1.

    Args:
        blur: standard deviation [px], any shape [...].
        reach: where it is cut [px].
        box: width of a square that it is convolved with [px], shape [...]; None for none.
    """
    omega = _frequencies(blur)
    transfer = torch.exp(-0.5 * (blur[..., None] * omega) ** 2)
    if box is not None:
        transfer = transfer * torch.sinc(box[..., None] * omega / (2 * math.pi))
    return _kernel(transfer, omega, reach)


def spline_kernel(blur: torch.Tensor, reach: int) -> torch.Tensor:
    """From an image to the coefficients of the blurred one's spline, from -reach to reach, shape [..., 2 reach + 1].

    Args:
        blur: standard deviation [px], any shape [...]; its type is the result's.
        reach: where it is cut [px], see :func:`spline_reach`.
    """
    omega = _frequencies(blur)
    kernel = torch.exp(-0.5 * (blur[..., None] * omega) ** 2) * filter_transfer(omega)
    # The splines' own filter has come to its end there.
    return _kernel(kernel, omega, reach, last=torch.where(blur > 0, 0.5, 1.0).to(blur.dtype))


def _frequencies(like: torch.Tensor) -> torch.Tensor:
    """Angular frequencies of the pixels' band [1/px], shape [FREQUENCIES]."""
    return (torch.arange(FREQUENCIES, device=like.device) + 0.5).to(like.dtype) * (math.pi / FREQUENCIES)


def _kernel(transfer: torch.Tensor, omega: torch.Tensor, reach: int, last: torch.Tensor | None = None) -> torch.Tensor:
    """Of a transfer function [..., FREQUENCIES], cut at ``reach`` and brought to a sum of 1.

    Args:
        transfer: at frequencies ``omega`` [1/px].
        omega: of :func:`_frequencies`.
        reach: where it is cut [px].
        last: share of the last value at either end that is kept, shape [...]; None for all of it. A kernel that rings
            on changes its sign from pixel to pixel, so that what is cut off sums up to half of its last value, with
            the other sign. Left in, that raises all but even light when the sum is brought to 1, by 0.3 % for a blur
            of 0.5 px that is cut after 17.
    """
    offset = torch.arange(-reach, reach + 1, device=omega.device)
    kernel = transfer @ torch.cos(omega[:, None] * offset) / FREQUENCIES
    if last is not None:
        kernel = torch.where(offset.abs() == reach, last[..., None] * kernel, kernel)
    return kernel / kernel.sum(dim=-1, keepdim=True)


def blur_reach(largest: float) -> int:
    """Where a blur of standard deviation ``largest`` [px] is cut [px]."""
    return max(LEAST_REACH, math.ceil(BLUR_REACH * largest))


def spline_reach(largest: float) -> int:
    """The same of :func:`spline_kernel`, which is no shorter than the splines' filter by itself."""
    return max(LEAST_SPLINE_REACH, blur_reach(largest))


def resampling_matrix(
    pixels: int, shift: torch.Tensor, scale: torch.Tensor, kernel: torch.Tensor | None = None
) -> torch.Tensor:
    """Rows that give each output pixel as a weighted sum of input pixels, shape [..., m, m]; each sums to 1.

    An output pixel is the mean over its own width. Beyond its border a picture is mirrored.

    Args:
        pixels: m.
        shift: of the picture towards larger coordinates [px], any shape [...]; its type is the result's.
        scale: magnification about the middle, less 1, above -1/2, a shape that broadcasts to it.
        kernel: of a blur besides, shape [..., 2 r + 1] likewise, see :func:`spline_kernel`; None for none.
    """
    device, dtype, middle = shift.device, shift.dtype, (pixels - 1) / 2
    if kernel is None:
        kernel = spline_kernel(torch.zeros_like(shift), EXACT_SPLINE_REACH)
    row = torch.arange(pixels, device=device, dtype=dtype)
    source = middle + (row - middle - shift[..., None]) / (1 + scale[..., None])  # [..., m]
    half = 0.5 / (1 + scale[..., None])
    return _spline_rows(pixels, source - half, source + half, kernel)


def _spline_rows(pixels: int, low: torch.Tensor, high: torch.Tensor, kernel: torch.Tensor) -> torch.Tensor:
    """Rows that give the spline's mean from ``low`` to ``high``, shape [..., k] -> [..., k, pixels]; each sums to 1."""
    first, weights = spline_taps(low, high)  # [..., k], [..., k, TAPS]
    weights = weights / weights.sum(dim=-1, keepdim=True)
    reach, size = kernel.shape[-1] // 2, kernel.shape[-1]
    wide = weights.new_zeros(*weights.shape[:-1], TAPS - 1 + size)
    for k in range(TAPS):
        wide[..., k : k + size] += weights[..., k : k + 1] * kernel[..., None, :]
    column = first.long()[..., None] + torch.arange(-reach, TAPS + reach, device=low.device)
    return weights.new_zeros(*weights.shape[:-1], pixels).scatter_add_(-1, mirrored(column, pixels), wide)


def regridding_matrix(pixels: int, wanted: int) -> torch.Tensor:
    """From so many pixels over a width to as many as are wanted over the same, shape [wanted, pixels], float64.

    A pixel is the mean over its width of the spline whose means are given: fewer pixels are means over areas, in which
    little aliases, more are a spline through means. Rows and, in units of a pixel's light, columns sum to 1, so that no
    light comes or goes. Beyond its border a picture is mirrored.

    Args:
        pixels: given.
        wanted: of the result; as many as are given make the identity.
    """
    if wanted == pixels:
        return torch.eye(pixels, dtype=torch.float64)
    pieces = -(-pixels // wanted)  # of a wanted pixel, none wider than one that is given
    edge = torch.arange(wanted * pieces + 1, dtype=torch.float64) * (pixels / (wanted * pieces)) - 0.5
    kernel = spline_kernel(torch.zeros((), dtype=torch.float64), EXACT_SPLINE_REACH)
    rows = _spline_rows(pixels, edge[:-1], edge[1:], kernel)
    return rows.reshape(wanted, pieces, pixels).mean(dim=1)


def regridded(maps: torch.Tensor, wanted: int) -> torch.Tensor:
    """Images or height maps with other numbers of pixels, shape [..., k, k] -> [..., wanted, wanted].

    What has as many already is given back as it is. The product is of the maps' type.
    """
    if maps.shape[-1] == wanted:
        return maps
    matrix = regridding_matrix(maps.shape[-1], wanted).to(maps)
    changed: torch.Tensor = matrix @ maps @ matrix.T
    return changed


def resampled(
    images: torch.Tensor, shift: torch.Tensor, scale: torch.Tensor, blur: torch.Tensor, reach: int
) -> torch.Tensor:
    """Images shifted, magnified about their middle and blurred; beyond its border a picture is mirrored.

    Args:
        images: shape [..., m, m].
        shift: towards larger x and y [px], shape [..., 2].
        scale: magnification less 1, shape [...].
        blur: standard deviation [px], shape [...].
        reach: where all blurs are cut [px], see :func:`spline_reach`; a number, so that no device is waited for.
    """
    pixels = images.shape[-1]
    kernel = spline_kernel(blur, reach)
    along_x, along_y = resampling_matrix(pixels, shift.movedim(-1, 0), scale, kernel)
    moved: torch.Tensor = along_y @ images @ along_x.transpose(-1, -2)
    return moved


def blur_matrix(pixels: int, blur: float) -> torch.Tensor:
    """Gaussian blur along one axis, shape [m, m], float64: symmetric, so its own adjoint; rows and columns sum to 1.

    At the border the picture is mirrored, which keeps all light and the matrix symmetric.

    Args:
        pixels: m.
        blur: standard deviation [px]; 0 gives the identity.
    """
    if blur == 0:
        return torch.eye(pixels, dtype=torch.float64)
    # A picture that is mirrored at its borders has a period of 2 m. A kernel that is cut instead, while it still rings,
    # and brought to a sum of 1, raises all but even light by its missing tail: by 0.6 % for a blur of 0.35 px that is
    # cut after 4, which looks like 0.4 % of stray light.
    transfer = _mirrored_transfer(pixels, blur, torch.device("cpu"))
    ring = torch.fft.irfft(transfer.to(torch.complex128), 2 * pixels)
    # ring[row - column] and ring[row + column + 1], as views: indices of all entries would take longer than the sum.
    back = torch.cat((ring[pixels + 1 :], ring[:pixels])).unfold(0, pixels, 1).flip(1)
    matrix: torch.Tensor = back + ring[1:].unfold(0, pixels, 1)[:pixels]
    return matrix


def blurred_rows(rows: torch.Tensor, blur: float) -> torch.Tensor:
    """Rows [..., m] times :func:`blur_matrix`, same shape, without that matrix of m x m.

    Args:
        rows: float64.
        blur: standard deviation [px]; 0 gives the rows themselves.
    """
    if blur == 0:
        return rows
    pixels = rows.shape[-1]
    periodic = torch.fft.rfft(torch.cat((rows, rows.flip(-1)), dim=-1))
    periodic *= _mirrored_transfer(pixels, blur, rows.device)
    found: torch.Tensor = torch.fft.irfft(periodic, 2 * pixels)[..., :pixels]
    return found


def _mirrored_transfer(pixels: int, blur: float, device: torch.device) -> torch.Tensor:
    """Of a Gaussian at the frequencies of a period of 2 m, shape [m + 1], float64."""
    omega = torch.arange(pixels + 1, dtype=torch.float64, device=device) * (math.pi / pixels)
    return torch.exp(-0.5 * (blur * omega) ** 2)


def mirrored_rows(kernel: torch.Tensor, pixels: int) -> torch.Tensor:
    """Matrix that convolves along one axis, mirrored at the border, shape [..., m, m].

    Args:
        kernel: from -reach to reach, shape [..., 2 reach + 1]; a symmetric one gives a symmetric matrix.
        pixels: m.
    """
    reach = kernel.shape[-1] // 2
    offset = torch.arange(-reach, reach + 1, device=kernel.device)
    column = mirrored(torch.arange(pixels, device=kernel.device)[:, None] + offset, pixels)
    column = column.expand(*kernel.shape[:-1], -1, -1)
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
