"""Any size through a network that halves: pad up to the next multiple, crop the answer."""

import torch
from torch.nn import functional

from warp_caustics.errors import InputError


def padding_to(size: int, multiple: int) -> tuple[int, int]:
    """How much to add (before, after) so that ``size`` becomes a multiple; the odd one goes after."""
    missing = -size % multiple
    return missing // 2, missing - missing // 2


def pad_to_multiple(x: torch.Tensor, multiple: int) -> torch.Tensor:
    """Pad rows and columns by repeating the edge, which is how the relief itself goes on.

    Args:
        x: shape [B, C, H, W].
        multiple: what rows and columns shall be divisible by.

    Returns:
        Shape [B, C, H', W'], ``x`` itself where nothing is missing.
    """
    top, bottom = padding_to(x.shape[-2], multiple)
    left, right = padding_to(x.shape[-1], multiple)
    if not (top or bottom or left or right):
        return x
    return functional.pad(x, (left, right, top, bottom), mode="replicate")


def crop_padding(x: torch.Tensor, size: tuple[int, int], multiple: int) -> torch.Tensor:
    """Undo :func:`pad_to_multiple`.

    Args:
        x: shape [B, C, H', W'].
        size: rows and columns before padding.
        multiple: as given to :func:`pad_to_multiple`.

    Returns:
        Shape [B, C, *size].
    """
    top, left = padding_to(size[0], multiple)[0], padding_to(size[1], multiple)[0]
    return x[..., top : top + size[0], left : left + size[1]]


def resolution_ratio(image_pixels: int, height_samples: int) -> int:
    """m / n, image pixels per height sample and side.

    Raises:
        InputError: the ratio is no whole number.
    """
    if image_pixels % height_samples:
        nearest = max(1, round(image_pixels / height_samples)) * height_samples
        raise InputError(
            f"{image_pixels} image pixels are no multiple of {height_samples} height samples, which networks need; "
            f"use a scene with image_pixels={nearest}"
        )
    return image_pixels // height_samples
