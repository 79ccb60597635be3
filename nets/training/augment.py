"""Symmetries of the set-up: turns and flips of plate and image together."""

import torch

from warp_caustics.scene import Scene


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
