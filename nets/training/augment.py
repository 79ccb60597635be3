"""Changes of training samples on the device: symmetries of the set-up, image noise, exposure."""

import torch

from warp_caustics.scene import Scene

DARKEST = 1e-3
"""Relative irradiance below which noise no longer falls."""


def scene_symmetries(scene: Scene) -> tuple[bool, bool, bool]:
    """Which of (mirror x, mirror y, swap x and y) map the set-up onto itself."""
    is_centred = [scene.screen_position_m[axis] == 0 for axis in (0, 1)]
    if not scene.is_collimated:
        is_centred = [is_centred[axis] and scene.light_position_m[axis] == 0 for axis in (0, 1)]
    is_square = scene.plate_size_m[0] == scene.plate_size_m[1]
    return is_centred[0], is_centred[1], is_square and is_centred[0] and is_centred[1]


def draw_symmetries(count: int, scene: Scene, generator: torch.Generator) -> torch.Tensor:
    """Symmetries of a batch, shape [3, count], bool: (mirror x, mirror y, swap x and y)."""
    drawn = torch.rand(3, count, generator=generator, device=generator.device) < 0.5
    for row, is_allowed in zip(drawn, scene_symmetries(scene), strict=True):
        if not is_allowed:
            row.fill_(False)
    return drawn


def transformed(maps: torch.Tensor, symmetries: torch.Tensor) -> torch.Tensor:
    """Apply symmetries to images or maps.

    Args:
        maps: shape [B, ..., k, k]; anything given per point: irradiance, heights, gradient with respect to heights.
        symmetries: shape [3, B].
    """
    mirror_x, mirror_y, swap = (row.reshape(-1, *[1] * (maps.ndim - 1)) for row in symmetries)
    maps = torch.where(mirror_x, maps.flip(-1), maps)
    maps = torch.where(mirror_y, maps.flip(-2), maps)
    return torch.where(swap, maps.transpose(-1, -2), maps)


def photographed(
    images: torch.Tensor, flat: torch.Tensor, noise: float, exposure: float, generator: torch.Generator
) -> torch.Tensor:
    """Images as a camera might see them: another brightness, and noise.

    The noise of an image with level sigma is Gaussian of standard deviation
    sigma * flat * (I / flat)^p. p is drawn per image from 0 (read-out) over 1/2
    (photons) to 1 (fixed pattern), because cameras differ; where the image is as
    bright as a flat plate, the noise is sigma whatever p.

    Args:
        images: I, shape [B, n_w, m, m] [W/m^2].
        flat: irradiance of a flat plate, shape [n_w, 1, 1] [W/m^2].
        noise: sigma is uniform from 0 to this.
        exposure: the brightness is off by a factor uniform in 1 -+ this.
        generator: on the images' device.
    """
    uniform = torch.rand(3, len(images), 1, 1, 1, generator=generator, device=images.device)
    if exposure:
        images = images * (1 + exposure * (2 * uniform[0] - 1))
    if noise:
        images = images + noise * uniform[1] * _unit_noise(images, flat, uniform[2], generator)
    return images


def noisy(images: torch.Tensor, flat: torch.Tensor, noise: float, generator: torch.Generator) -> torch.Tensor:
    """Images with photon noise of one level; arguments as of :func:`photographed`."""
    power = images.new_full((len(images), 1, 1, 1), 0.5)
    return images + noise * _unit_noise(images, flat, power, generator)


def _unit_noise(
    images: torch.Tensor, flat: torch.Tensor, power: torch.Tensor, generator: torch.Generator
) -> torch.Tensor:
    scale = flat * (images / flat).clamp(min=DARKEST) ** power
    return scale * torch.randn(images.shape, generator=generator, device=images.device)
