"""Halving and doubling convolutions in shapes that tensor cores take; the same numbers to rounding.

A convolution of stride 2 is one of stride 1 over blocks of 2 x 2 samples, which are its channels then, and a
transposed one answers such blocks. In half precision on a GPU libraries are slow at strides, at kernels of many
taps over few channels, and at numbers of channels that are no multiple of 8: there `nets/unet.py` computes its
blocks so while they learn (docs/training.md has the times). Weights keep the shape of the printed architecture.
"""

import torch
from torch.nn import functional

MULTIPLES = (32, 8)
"""Of channels: 64 in place of 54 are twice as fast on an H100, 56 once and a half."""
MOST_ADDED = 1.2
"""Times the channels, at most, for the larger multiple: what is added is computed, too."""


def is_wanted(x: torch.Tensor, weight: torch.Tensor) -> bool:
    """Whether a block is being trained in half precision on a GPU."""
    is_learning = torch.is_grad_enabled() and weight.requires_grad
    return x.is_cuda and is_learning and torch.is_autocast_enabled("cuda")


def round_channels(channels: int) -> int:
    """The next number of channels that tensor cores are fast with."""
    larger, smaller = (-(-channels // multiple) * multiple for multiple in MULTIPLES)
    return larger if larger <= MOST_ADDED * channels else smaller


def widened(x: torch.Tensor) -> torch.Tensor:
    """``x`` [B, C, H, W] with channels of zeros up to the number that tensor cores are fast with."""
    missing = round_channels(x.shape[1]) - x.shape[1]
    return torch.cat((x, x.new_zeros(len(x), missing, *x.shape[-2:])), dim=1) if missing else x


def spare_channels(weight: torch.Tensor, channels: int) -> torch.Tensor:
    """Kernels [c_out, c_in, k, k] that take no notice of input channels beyond c_in; shape [c_out, channels, k, k]."""
    return functional.pad(weight, (0, 0, 0, 0, 0, channels - weight.shape[1]))


def convolved(x: torch.Tensor, weight: torch.Tensor, bias: torch.Tensor | None) -> torch.Tensor:
    """Convolution of stride 1 that keeps the size; odd kernels.

    Args:
        x: shape [B, C, H, W], C at least c_in; channels beyond c_in are not looked at.
        weight: shape [c_out, c_in, k, k].
        bias: shape [c_out].
    """
    return functional.conv2d(x, spare_channels(weight, x.shape[1]), bias, padding=weight.shape[-1] // 2)


def _even(kernel: int) -> tuple[int, int]:
    """Zeros before and after k taps that make pairs of them and an odd number of pairs, centred on the block."""
    before = (kernel - 1) // 2 % 2
    after = (before + kernel) % 2
    pairs = (before + kernel + after) // 2
    # The centre pair is the one with tap (k - 1) // 2, whose sample is the first of its block.
    centre = (before + (kernel - 1) // 2) // 2
    missing = 2 * centre + 1 - pairs
    return before + 2 * max(0, -missing), after + 2 * max(0, missing)


def halved(x: torch.Tensor, weight: torch.Tensor, bias: torch.Tensor | None) -> torch.Tensor:
    """``conv2d(x, weight, bias, stride=2, padding=(k - 1) // 2)``.

    Args:
        x: shape [B, c_in, H, W], H and W even.
        weight: shape [c_out, c_in, k, k].
        bias: shape [c_out].

    Returns:
        Shape [B, c_out, H / 2, W / 2].
    """
    blocks = functional.pixel_unshuffle(x, 2)
    before, after = _even(weight.shape[-1])
    c_out, c_in = weight.shape[:2]
    pairs = (before + weight.shape[-1] + after) // 2
    taps = functional.pad(weight, (before, after, before, after)).reshape(c_out, c_in, pairs, 2, pairs, 2)
    taps = taps.permute(0, 1, 3, 5, 2, 4).reshape(c_out, 4 * c_in, pairs, pairs)
    return convolved(widened(blocks), taps, bias)


def doubled(x: torch.Tensor, weight: torch.Tensor, bias: torch.Tensor | None) -> torch.Tensor:
    """``conv_transpose2d(x, weight, bias, stride=2, padding=(k - 1) // 2, output_padding=k % 2)``.

    Args:
        x: shape [B, c_in, H, W].
        weight: shape [c_in, c_out, k, k].
        bias: shape [c_out].

    Returns:
        Shape [B, c_out, 2 H, 2 W].
    """
    before, after = _even(weight.shape[-1])
    c_in, c_out = weight.shape[:2]
    pairs = (before + weight.shape[-1] + after) // 2
    taps = functional.pad(weight, (before, after, before, after)).reshape(c_in, c_out, pairs, 2, pairs, 2)
    # A transposed convolution runs through its taps the other way round.
    taps = taps.flip(2, 4).permute(1, 3, 5, 0, 2, 4).reshape(4 * c_out, c_in, pairs, pairs)
    blocks = convolved(widened(x), taps, None if bias is None else bias.repeat_interleave(4))
    return functional.pixel_shuffle(blocks, 2)
