"""Where the window's picture lies in the photo, for each wavelength.

A position u on the window, -1 to 1, goes to the photo by

    x = m + a + (1 + c_i) (M p / 2 R h(u) + shift),     a = colour shift i,  m = the photo's middle,

with h the homography, R the turn, M the magnification, p pixels of the window and c_i the colour scale: geometry
first, then lateral colour, which a lens makes about its axis.
"""

from typing import NamedTuple

import torch

from warp_caustics.camera.parameters import CameraParameters


class Frame(NamedTuple):
    """Size of a photo [px]."""

    width: int
    height: int


def pixel_edges(parameters: CameraParameters, frame: Frame, pixels: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Edges of the photo's columns and rows on the window, for cameras that are upright and without a homography.

    Args:
        parameters: turn and homography are not looked at.
        frame: size of the photo.
        pixels: m.

    Returns:
        Pixel coordinates of the window, shapes [..., n_w, width + 1] and [..., n_w, height + 1].
    """
    edges = []
    for axis, size in enumerate(frame):
        along = torch.arange(size + 1, device=parameters.shift_px.device).to(parameters.shift_px.dtype) - size / 2
        away = along - parameters.colour_shift_px[..., axis, None]
        away = away / (1 + parameters.colour_scale[..., None]) - parameters.shift_px[..., None, axis, None]
        edges.append(away / parameters.magnification[..., None, None] + (pixels - 1) / 2)
    return edges[0], edges[1]


def to_photo(parameters: CameraParameters, frame: Frame, pixels: int) -> torch.Tensor:
    """Homogeneous maps from the window's pixel coordinates to the photo's, shape [..., n_w, 3, 3]."""
    p = parameters
    half = pixels / 2
    one, zero = torch.ones_like(p.turn_rad), torch.zeros_like(p.turn_rad)
    normalised = _rows(
        ((one / half, zero, (1 / half - 2) / 2 * one), (zero, one / half, (1 / half - 2) / 2 * one), (zero, zero, one))
    )
    a, b = p.magnification * half * torch.cos(p.turn_rad), p.magnification * half * torch.sin(p.turn_rad)
    similar = _rows(((a, -b, p.shift_px[..., 0]), (b, a, p.shift_px[..., 1]), (zero, zero, one)))
    placed = similar @ p.homography @ normalised
    scale = 1 + p.colour_scale
    one, zero = torch.ones_like(scale), torch.zeros_like(scale)
    x, y = (p.colour_shift_px[..., axis] + (frame[axis] - 1) / 2 for axis in (0, 1))
    coloured = _rows(((scale, zero, x), (zero, scale, y), (zero, zero, one)))
    return coloured @ placed[..., None, :, :]


def _rows(rows: tuple[tuple[torch.Tensor, ...], ...]) -> torch.Tensor:
    return torch.stack([torch.stack(torch.broadcast_tensors(*row), dim=-1) for row in rows], dim=-2)


class Seen(NamedTuple):
    """What pixels of the photo see of the window, in its pixel coordinates."""

    x: torch.Tensor
    """Their centres."""
    y: torch.Tensor
    width: torch.Tensor
    """Length on the window of a pixel's step along both axes together, as if it lay straight: for a turned pixel that
    of the straight square of its size."""
    height: torch.Tensor


def seen_of_window(to_window: torch.Tensor, rows: torch.Tensor, columns: torch.Tensor) -> Seen:
    """What the photo's pixels see of the window.

    Args:
        to_window: inverse of :func:`to_photo`, shape [..., n_w, 3, 3].
        rows: y of the photo's pixels [px], shape [H].
        columns: x [px], shape [W].

    Returns:
        Fields of shape [..., n_w, H, W].
    """
    column, row = columns[None, :], rows[:, None]

    def entry(i: int, j: int) -> torch.Tensor:
        return to_window[..., i, j, None, None]

    up_x, up_y, down = (entry(i, 0) * column + entry(i, 1) * row + entry(i, 2) for i in range(3))
    x, y = up_x / down, up_y / down
    steps = [
        [(entry(i, j) - place * entry(2, j)) / down for j in (0, 1)] for i, place in enumerate((x, y))
    ]  # derivative of window position i by photo position j
    return Seen(x, y, *(torch.sqrt(along**2 + across**2) for along, across in steps))


def corners_px(parameters: CameraParameters, frame: Frame, pixels: int, wavelength: int) -> torch.Tensor:
    """Where a wavelength shows the window's corners -x-y, +x-y, +x+y, -x+y, shape [..., 4, 2] [px]."""
    maps = to_photo(parameters, frame, pixels)[..., wavelength, :, :]
    low, high = -0.5, pixels - 0.5
    at = maps.new_tensor([[low, low, 1], [high, low, 1], [high, high, 1], [low, high, 1]])
    mapped = at @ maps.transpose(-1, -2)
    return mapped[..., :2] / mapped[..., 2:]
