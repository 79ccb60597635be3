"""Colour filters of a sensor: one channel for each pixel, and what is made up in between.

Patterns are named by their first 2 x 2 pixels row by row, such as rggb; channels are red, green, blue.
"""

from functools import lru_cache

import torch
from torch.nn import functional

CHANNELS = "rgb"


@lru_cache(maxsize=16)
def filter_mask(pattern: str, height: int, width: int, dtype: torch.dtype, device: torch.device) -> torch.Tensor:
    """1 where a channel's filter lies, else 0, shape [3, H, W]."""
    cell = torch.tensor([[float(name == channel) for name in pattern] for channel in CHANNELS], dtype=dtype)
    repeated = cell.reshape(3, 2, 2).repeat(1, (height + 1) // 2, (width + 1) // 2)
    return repeated[:, :height, :width].to(device)


def mosaicked(signal: torch.Tensor, pattern: str) -> torch.Tensor:
    """What the pixels behind their filters hold, shape [..., H, W], of all channels [..., 3, H, W]."""
    mask = filter_mask(pattern, *signal.shape[-2:], signal.dtype, signal.device)
    return (signal * mask).sum(-3)


def demosaicked(raw: torch.Tensor, pattern: str) -> torch.Tensor:
    """All channels of a mosaic, bilinear: the mean of a channel's nearest neighbours where another filter lies.

    At the border the mosaic is mirrored about its outermost pixels, which keeps the order of its filters.

    Args:
        raw: shape [..., H, W], both at least 2.
        pattern: the filters.

    Returns:
        Shape [..., 3, H, W].
    """
    height, width = raw.shape[-2:]
    mask = filter_mask(pattern, height, width, raw.dtype, raw.device)
    planes = (raw[..., None, :, :] * mask).reshape(-1, 3, height, width)
    side = raw.new_tensor([0.5, 1.0, 0.5])
    # Red and blue lie on every second pixel along both axes, green on every second along diagonals.
    square = side[:, None] * side[None, :]
    cross = raw.new_tensor([[0.0, 0.25, 0.0], [0.25, 1.0, 0.25], [0.0, 0.25, 0.0]])
    kernels = torch.stack((square, cross, square))[:, None]
    full = functional.conv2d(functional.pad(planes, (1, 1, 1, 1), mode="reflect"), kernels, groups=3)
    return full.reshape(*raw.shape[:-2], 3, height, width)
