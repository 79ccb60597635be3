"""One image seen in all its turns and flips: a network answers each a little differently, and the mean is better."""

import itertools

import torch

from nets.training.augment import scene_symmetries, transformed
from warp_caustics.scene import Scene


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
