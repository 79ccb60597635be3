"""What training minimises."""

from typing import Literal

import torch

MM = 1e3
"""Millimetres per metre: losses are of order one."""


def slope_error(difference: torch.Tensor, pitch: tuple[float, float]) -> torch.Tensor:
    """Mean magnitude of the slopes of a difference of heights.

    Args:
        difference: shape [B, n, n] [m].
        pitch: distance of samples along x and y [m].

    Returns:
        Scalar, metre per metre.
    """
    along_x = difference.diff(dim=-1).abs().mean() / pitch[0]
    along_y = difference.diff(dim=-2).abs().mean() / pitch[1]
    return (along_x + along_y) / 2


def relief_loss(
    heights: torch.Tensor, truth: torch.Tensor, pitch: tuple[float, float], slope_weight: float
) -> torch.Tensor:
    """Mean magnitude of the error [mm] plus weighted error of the slopes; heights of shape [B, n, n] [m]."""
    difference = heights - truth
    loss = difference.abs().mean() * MM
    return loss + slope_weight * slope_error(difference, pitch) if slope_weight else loss


def total_variation(heights: torch.Tensor) -> torch.Tensor:
    """Sum of the magnitudes of all steps between neighbours, mean over the batch [mm]; shape [B, n, n] [m]."""
    steps = heights.diff(dim=-1).abs().sum() + heights.diff(dim=-2).abs().sum()
    return steps * MM / len(heights)


def update_loss(
    heights: torch.Tensor, truth: torch.Tensor, measure: Literal["squared", "absolute"], lambda_tv: float
) -> torch.Tensor:
    """Height error plus lambda_TV * TV (section 2.2).

    The supplement names the error "height error" and the weight 1e-9; both leave units open. Here the error is a
    mean over samples [mm^2] or [mm], and TV a sum over samples [mm].
    """
    difference = (heights - truth) * MM
    error = difference.square().mean() if measure == "squared" else difference.abs().mean()
    return error + lambda_tv * total_variation(heights) if lambda_tv else error


def relief_rmse_um(heights: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    """Root mean square error of each relief [um], shape [B], of heights [B, n, n] [m]."""
    return (heights - truth).square().mean(dim=(-2, -1)).sqrt() * 1e6


def psnr_db(image: torch.Tensor, truth: torch.Tensor, peak: float) -> torch.Tensor:
    """Peak signal-to-noise ratio of each image and wavelength [dB], shape [B, n_w], of images [B, n_w, m, m]."""
    error = (image - truth).square().mean(dim=(-2, -1)).clamp(min=1e-30)
    return 10 * torch.log10(peak**2 / error)
