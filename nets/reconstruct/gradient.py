"""Image of the current relief, and which way the data term falls: what a learned updater is shown."""

from collections.abc import Callable

import torch

from warp_caustics.simulator import CausticSimulator

Denoiser = Callable[[torch.Tensor], torch.Tensor]
"""Noisy images [B, n_w, m, m] to denoised ones."""


def data_gradient(
    simulator: CausticSimulator, heights: torch.Tensor, target: torch.Tensor, denoiser: Denoiser | None = None
) -> tuple[torch.Tensor, torch.Tensor]:
    """D(S(h)), and the gradient of E = 1/2 sum_w mean_pixels (D(S(h)) - I)^2 with respect to h.

    The denoiser D counts as the identity in its derivative, because noise does not depend on the heights.
    Heights that are no glass are replaced first: a network may answer anything.

    Args:
        simulator: S.
        heights: h [m], shape [B, n, n].
        target: I [W/m^2], shape [B, n_w, m, m].
        denoiser: D; none if None.

    Returns:
        Image [W/m^2], shape of target, and gradient [W^2/m^5], shape of heights.
    """
    lowest = -0.99 * simulator.scene.base_thickness_m
    leaf = heights.detach().nan_to_num(0.0, 0.0, 0.0).clamp(min=lowest).contiguous().requires_grad_()
    simulated = simulator(leaf)
    with torch.no_grad():
        shown = simulated.detach() if denoiser is None else denoiser(simulated.detach())
        residual = (shown - target) / (target.shape[-1] * target.shape[-2])
    (gradient,) = torch.autograd.grad(simulated, leaf, residual)
    return shown, gradient
