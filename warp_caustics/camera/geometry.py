"""The window's picture in the photo's pixels: a linear operator on images, differentiable by the placement too.

An upright camera is one product with a banded matrix along x and one along y. A turned one, or one that looks from
the side, gathers 7 x 7 spline coefficients for each pixel; a turned pixel is taken for a straight square of its size.
"""

import torch
from torch.utils.checkpoint import checkpoint

from warp_caustics.camera.parameters import CameraParameters
from warp_caustics.camera.placement import Frame, pixel_edges, seen_of_window, to_photo
from warp_caustics.camera.spline_pixels import pixel_matrix, pixel_taps, spline_coefficients
from warp_caustics.pixel_spline import TAPS

CHUNK = {"cpu": 1 << 20, "cuda": 1 << 25}
"""Weights that a gather holds at a time: what stays in the caches of a CPU, twice as fast as four times as many; on a
GPU large enough that launches do not count."""


def upright_matrices(
    parameters: CameraParameters, frame: Frame, pixels: int, is_dark: bool
) -> tuple[torch.Tensor, torch.Tensor]:
    """Matrices along x and y, shapes [..., n_w, width, m] and [..., n_w, height, m].

    Args:
        parameters: turn and homography are not looked at.
        frame: size of the photo.
        pixels: m.
        is_dark: no light beyond the window; else the image is mirrored there.
    """
    x, y = pixel_edges(parameters, frame, pixels)
    return pixel_matrix(x, pixels, is_dark), pixel_matrix(y, pixels, is_dark)


def gathered(images: torch.Tensor, parameters: CameraParameters, frame: Frame, is_dark: bool) -> torch.Tensor:
    """Images as a camera in any position shows them, shape [..., n_w, height, width].

    For a gradient each chunk of rows is computed again, so that memory holds one of them.

    Args:
        images: shape [..., n_w, m, m].
        parameters: with the same leading dimensions, or some that broadcast.
        frame: size of the photo.
        is_dark: no light beyond the window; else the image is mirrored there.
    """
    coefficients = spline_coefficients(images)
    to_window = torch.linalg.inv(to_photo(parameters, frame, images.shape[-1]))
    shape = torch.broadcast_shapes(images.shape[:-2], to_window.shape[:-2])
    coefficients = coefficients.expand(*shape, -1, -1).reshape(shape.numel(), -1)
    is_recorded = torch.is_grad_enabled() and (coefficients.requires_grad or to_window.requires_grad)
    parts = []
    step = max(1, CHUNK.get(images.device.type, CHUNK["cuda"]) // (TAPS * frame.width * shape.numel()))
    for first in range(0, frame.height, step):
        rows = torch.arange(first, min(first + step, frame.height), device=images.device).to(images.dtype)
        arguments = (coefficients, to_window, rows, frame.width, images.shape[-1], is_dark)
        if is_recorded:
            parts.append(checkpoint(_rows_gathered, *arguments, use_reentrant=False))
        else:
            parts.append(_rows_gathered(*arguments))
    return torch.cat(parts, dim=-2).reshape(*shape, frame.height, frame.width)


def _rows_gathered(
    coefficients: torch.Tensor, to_window: torch.Tensor, rows: torch.Tensor, width: int, pixels: int, is_dark: bool
) -> torch.Tensor:
    """Some rows of the photo, shape [N, h, width], of coefficients [N, m m]."""
    count = len(coefficients)
    seen = seen_of_window(to_window, rows, torch.arange(width, device=rows.device).to(rows.dtype))
    column, along_x = pixel_taps(seen.x - seen.width / 2, seen.x + seen.width / 2, pixels, is_dark)
    row, along_y = pixel_taps(seen.y - seen.height / 2, seen.y + seen.height / 2, pixels, is_dark)
    result: torch.Tensor | float = 0.0
    for tap in range(TAPS):
        index = row[..., tap, None] * pixels + column  # [..., n_w, h, W, TAPS]
        # Of one camera for many images, each finds the same places.
        index = _repeated(index, count).reshape(count, -1)
        values = coefficients.gather(1, index).reshape(count, len(rows), width, TAPS)
        weights = along_y[..., tap, None] * along_x
        result = result + (values * _repeated(weights, count)).sum(-1)
    assert isinstance(result, torch.Tensor)
    return result


def _repeated(values: torch.Tensor, count: int) -> torch.Tensor:
    """Of shape [..., n_w, h, W, TAPS] for ``count`` images in the order of their leading dimensions."""
    flat = values.reshape(-1, *values.shape[-3:])
    return flat if len(flat) == count else flat.repeat(count // len(flat), 1, 1, 1)
