"""Physical quantities as numbers of order one, and back.

All of it is computed in float32 whatever the precision around it: heights are
wanted to a fraction of a percent, which bfloat16 does not have.
"""

from contextlib import AbstractContextManager, nullcontext

import torch
from torch.nn import functional

from warp_caustics.scene import Scene


def full_precision(x: torch.Tensor) -> AbstractContextManager[object]:
    """Context in which autocast is off for the device of ``x``."""
    # A meta tensor, which counts but computes nothing, knows no autocast.
    return nullcontext() if x.is_meta else torch.autocast(x.device.type, enabled=False)


def flat_irradiance(scene: Scene) -> torch.Tensor:
    """Irradiance behind a plate without relief, 1 where a wavelength has no light [W/m^2], shape [n_w, 1, 1]."""
    return torch.tensor([value or 1.0 for value in scene.radiosity_W_m2], dtype=torch.float32).reshape(-1, 1, 1)


def log_image(image: torch.Tensor, floor: float) -> torch.Tensor:
    """log((I + eps) / (1 + eps)): 0 for a flat plate, bounded below; noise below 0 counts as 0.

    Args:
        image: irradiance relative to a flat plate, any shape.
        floor: eps.
    """
    return torch.log((image.clamp(min=0.0) + floor) / (1.0 + floor))


def clipped_image(image: torch.Tensor, clip: float) -> torch.Tensor:
    """I - 1, cut at ``clip``; 0 for a flat plate.

    Args:
        image: irradiance relative to a flat plate, any shape.
        clip: largest I that is told apart.
    """
    return image.clamp(0.0, clip) - 1.0


def slopes(heights: torch.Tensor, pitch: tuple[float, float], clip: float) -> torch.Tensor:
    """Central differences, one-sided at the edge: what bends the light.

    Args:
        heights: shape [B, 1, n, n] [m].
        pitch: distance of samples along x and y [m].
        clip: largest slope that is told apart.

    Returns:
        dh/dx and dh/dy, shape [B, 2, n, n].
    """
    # The repeated edge halves the difference there, and the distance is one sample instead of two.
    padded = functional.pad(heights, (1, 1, 1, 1), mode="replicate")
    along_x = (padded[..., 1:-1, 2:] - padded[..., 1:-1, :-2]) / (2.0 * pitch[0])
    along_y = (padded[..., 2:, 1:-1] - padded[..., :-2, 1:-1]) / (2.0 * pitch[1])
    return torch.cat((along_x, along_y), dim=1).clamp(-clip, clip)


def scaled_gradient(gradient: torch.Tensor) -> torch.Tensor:
    """asinh(g / RMS(g)) of each plate: its size depends on the loss, its tails are heavy at focal lines.

    Args:
        gradient: shape [B, 1, n, n], any unit.

    Returns:
        Shape [B, 1, n, n]; zeros where the gradient is 0 everywhere.
    """
    largest = gradient.abs().amax(dim=(-2, -1), keepdim=True)
    # First by the largest value: squares of a gradient near 1e-25 would be 0 in float32.
    relative = gradient / torch.where(largest > 0, largest, 1.0)
    rms = relative.square().mean(dim=(-2, -1), keepdim=True).sqrt()
    return torch.asinh(relative / torch.where(rms > 0, rms, 1.0))
