"""Symmetries of the set-up: turns and flips of plate and image together.

Training draws one at random for each sample; a reconstruction looks at an image in all of them, since a network
answers each a little differently and the mean is better.
"""

import itertools

import torch

from warp_caustics.scene import Scene


def scene_symmetries(scene: Scene) -> tuple[bool, bool, bool]:
    """Which of (mirror x, mirror y, swap x and y) map the set-up onto itself."""
    is_centred = [scene.screen_position_m[axis] == 0 for axis in (0, 1)]
    if not scene.is_collimated:
        is_centred = [is_centred[axis] and scene.light_position_m[axis] == 0 for axis in (0, 1)]
    is_centred = [is_centred[axis] and scene.light_tilt_rad[axis] == 0 for axis in (0, 1)]
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


def all_symmetries(scene: Scene) -> torch.Tensor:
    """Turns and flips that map the set-up onto itself, the identity first; shape [3, B] (mirror x, mirror y, swap).

    Eight for a square plate under centred light, four for an oblong one, one where nothing is symmetric.
    """
    choices = [(False, True) if is_allowed else (False,) for is_allowed in scene_symmetries(scene)]
    # The swap varies slowest: the first half of the eight is a group of its own, the flips.
    found = [(x, y, swap) for swap, y, x in itertools.product(*reversed(choices))]
    return torch.tensor(found, dtype=torch.bool).T


def seen_in(image: torch.Tensor, symmetries: torch.Tensor) -> torch.Tensor:
    """One image or map in each symmetry; shape [..., k, k] -> [B, ..., k, k]."""
    copies = image.expand(symmetries.shape[1], *image.shape)
    return transformed(copies, symmetries.to(image.device)).contiguous()


def turned_back(maps: torch.Tensor, symmetries: torch.Tensor) -> torch.Tensor:
    """Undo :func:`seen_in`, sample by sample; shape [B, ..., k, k]."""
    mirror_x, mirror_y, swap = symmetries.to(maps.device)
    none = torch.zeros_like(swap)
    maps = transformed(maps, torch.stack([none, none, swap]))
    return transformed(maps, torch.stack([mirror_x, mirror_y, none]))
