"""From gradients of scattered photons' surfaces to those of spline coefficients."""

from typing import Any

import torch
import warp as wp

from warp_caustics.chunked import warp_array
from warp_caustics.kernels import dtype_of
from warp_caustics.kernels.fixed_point import MOST_STEPS
from warp_caustics.kernels.surface_adjoint import surface_adjoint_kernel

LEAST_GRADIENT = 1e-200
"""Steps are no finer than for gradients of this size, so that they are finite."""


def gathered_adjoint(shape: tuple[int, ...], photons: Any, grad_maps: torch.Tensor) -> torch.Tensor:
    """Gradient with respect to the coefficients, of the type of ``grad_maps``.

    Args:
        shape: of the coefficients, [B, n + 4, n + 4].
        photons: struct ``Photons`` of N scattered ones.
        grad_maps: gradient with respect to their surface maps [B, 6, N].
    """
    sums = grad_maps.new_zeros(shape)
    _share(photons, grad_maps, torch.ones(shape[0], dtype=torch.float64, device=grad_maps.device), sums)
    return sums


def gathered_in_order(
    shape: tuple[int, ...], photons: Any, grad_maps: torch.Tensor, pitch_m: tuple[float, float]
) -> torch.Tensor:
    """The same to the last bit in whatever order photons come; nothing waits for a GPU.

    Args:
        shape: of the coefficients, [B, n + 4, n + 4].
        photons: struct ``Photons`` of N scattered ones.
        grad_maps: gradient with respect to their surface maps [B, 6, N].
        pitch_m: of the height samples along x and y [m].
    """
    steps = steps_of(grad_maps, pitch_m)
    sums = torch.zeros(shape, dtype=torch.int64, device=grad_maps.device)
    _share(photons, grad_maps, steps, sums)
    return (sums / steps[:, None, None]).to(grad_maps.dtype)


def _share(photons: Any, grad_maps: torch.Tensor, steps: torch.Tensor, sums: torch.Tensor) -> None:
    batch, _, count = grad_maps.shape
    wp.launch(
        surface_adjoint_kernel(dtype_of(torch.finfo(grad_maps.dtype).bits), not sums.is_floating_point()),
        dim=(batch, count),
        inputs=[photons, warp_array(grad_maps), warp_array(steps)],
        outputs=[warp_array(sums)],
        device=wp.device_from_torch(grad_maps.device),
    )


def steps_of(grad_maps: torch.Tensor, pitch_m: tuple[float, float]) -> torch.Tensor:
    """Steps of fixed-point sums per unit of gradient, shape [B], float64: powers of two with which no sum overflows.

    Args:
        grad_maps: gradient of the surface maps [B, 6, N]; where it is no number, steps are none either.
        pitch_m: of the height samples along x and y [m].
    """
    lowest, highest = grad_maps.aminmax(dim=2)
    most = torch.maximum(-lowest, highest).double()
    # Weights of spline, slope and curvature are at most 1, 1 and 2 per sample.
    x, y = (1 / pitch for pitch in pitch_m)
    weights = (1.0, x, y, 2 * x * x, x * y, 2 * y * y)
    bound = sum((most[:, k] * weight for k, weight in enumerate(weights)), torch.zeros_like(most[:, 0]))
    return torch.exp2(torch.floor(torch.log2(MOST_STEPS / (grad_maps.shape[2] * bound.clamp_min(LEAST_GRADIENT)))))
