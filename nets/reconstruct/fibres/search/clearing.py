"""A place of a plate cleared of lines: short ones are taken away, long ones that end there are cut back to its edge."""

from collections.abc import Iterator
from typing import NamedTuple

import torch

from nets.reconstruct.fibres.search.moves import SHORTEST_M
from warp_caustics.prints.model import LineModel

Place = tuple[float, float]
"""x and y on the plate [m]."""


class Clearing(NamedTuple):
    """Lines without those that were taken away.

    Attributes:
        lines: shape [K, 6] [m].
        cut: indices in ``lines`` of those that were cut back.
        taken: how many were taken away.
    """

    lines: torch.Tensor
    cut: list[int]
    taken: int


def clearings(lines: torch.Tensor, place: Place, radius_m: float) -> Iterator[Clearing]:
    """Ways to clear a place: all lines within it taken away, and of those that end there none, one, or all cut.

    Args:
        lines: shape [L, 6] [m].
        place: its centre.
        radius_m: how far it goes.
    """
    ends = lines[:, :4].reshape(-1, 2, 2)
    is_inside = (ends - lines.new_tensor(place)).norm(dim=2) <= radius_m
    gone: list[int] = is_inside.all(dim=1).nonzero()[:, 0].tolist()
    ending: list[int] = (is_inside.sum(dim=1) == 1).nonzero()[:, 0].tolist()
    kept = [k for k in range(len(lines)) if k not in gone]
    some = [[], *([k] for k in ending), *([ending] if len(ending) > 1 else [])]
    for shortened in some:
        if not gone and not shortened:
            continue
        changed = lines.clone()
        for k in shortened:
            changed[k] = cut_back(lines[k], 0 if is_inside[k, 0] else 2, place, radius_m)
        yield Clearing(changed[kept], [kept.index(k) for k in shortened], len(gone))


def cut_back(line: torch.Tensor, column: int, place: Place, radius_m: float) -> torch.Tensor:
    """A line [6] [m] whose end in column 0 or 2 lies within a place, cut back to the place's edge; never to nothing."""
    start, end = line[2 - column : 4 - column], line[column : column + 2]
    way, away = end - start, start - line.new_tensor(place)
    a, b, c = way @ way, away @ way, away @ away - radius_m**2
    share = (-b - (b.square() - a * c).clamp_min(0.0).sqrt()) / a.clamp_min(1e-18)
    shortened = line.clone()
    least = float(SHORTEST_M / a.sqrt().clamp_min(SHORTEST_M))
    shortened[column : column + 2] = start + share.clamp(least, 1.0) * way
    return shortened


def within(model: LineModel, place: Place, radius_m: float) -> torch.Tensor:
    """Which samples lie within a place, shape [n, n]."""
    axes = [
        ((torch.arange(model.n, device=model.device) + 0.5) * pitch - size / 2 - at).square()
        for pitch, size, at in zip(model.scene.sample_pitch_m, model.scene.plate_size_m, place, strict=True)
    ]
    return axes[0][None, :] + axes[1][:, None] <= radius_m**2


def reaching(model: LineModel, lines: torch.Tensor, place: Place, radius_m: float) -> list[int]:
    """Indices of lines [L, 6] [m] that have relief within a place."""
    is_there = (model.each(lines) > 0) & within(model, place, radius_m)
    found: list[int] = is_there.flatten(1).any(1).nonzero()[:, 0].tolist()
    return found
