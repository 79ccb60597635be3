"""Lines with corners and curves, and the first guess of one from its ridge."""

from dataclasses import dataclass

import numpy as np
import scipy  # loads its parts when they are first used

from warp_caustics.prints.smooth_chains import Track, track_through
from warp_caustics.prints.vectorise.ridges import Ridge
from warp_caustics.types import FloatArray

LEAST_M = 1.5e-5
"""Height of the lowest lines that are looked for [m]."""
PENALTY = 12.0
"""Loss that a line must save, and"""
NODE_PENALTY = 1.0
"""that each of its nodes must."""
WIDTHS_M = 2e-4, 4e-3
"""Of a line that a ridge tells."""
PROFILE_SAMPLES, PROFILE_STEP = 14.0, 0.25
"""How far across a ridge is looked, and in which steps [samples]."""
NODE_SAMPLES = 2.05
"""Distance of nodes [samples]."""
LOW_OF_RIDGE = 0.35
"""Quantile of the heights along a ridge that is taken for the line's own: others lie on top in places."""
NARROW_OF_RIDGE = 0.4
"""The same of widths, where no other line lies on top."""


@dataclass(frozen=True, eq=False)
class CurvedLines:
    """Lines along tracks.

    Attributes:
        tracks: of each.
        sizes: widths and heights [m], shape [L, 2], float64.
    """

    tracks: list[Track]
    sizes: FloatArray

    def __len__(self) -> int:
        return len(self.tracks)

    def kept(self, which: list[int]) -> "CurvedLines":
        """Some of them."""
        return CurvedLines([self.tracks[k] for k in which], self.sizes[which])

    def with_more(self, others: "CurvedLines") -> "CurvedLines":
        """These and others."""
        return CurvedLines([*self.tracks, *others.tracks], np.concatenate([self.sizes, others.sizes]))


def penalty_of(track: Track) -> float:
    """Loss that a line must save."""
    return PENALTY + NODE_PENALTY * len(track.nodes_m)


def line_of_ridge(
    ridge: Ridge, relief: FloatArray, pitch_m: tuple[float, float], plate_m: tuple[float, float], wider: float
) -> CurvedLines | None:
    """The line whose ridge this is; None if nothing of it is above the plate.

    Others lie on top in places, so what is low and narrow is taken for the line's own.
    """
    points, pitch = ridge.points, float(np.mean(pitch_m))
    ways = np.gradient(points, axis=0)
    ways /= np.maximum(np.hypot(*ways.T), 1e-12)[:, None]
    normals = np.stack([-ways[:, 1], ways[:, 0]], axis=1)
    offsets = np.arange(0.0, PROFILE_SAMPLES, PROFILE_STEP)
    profile = []
    for side in (-1, 1):
        at = points[:, None] + side * offsets[None, :, None] * normals[:, None]
        profile.append(scipy.ndimage.map_coordinates(relief, [at[..., 1], at[..., 0]], order=1, mode="nearest"))
    crown = np.maximum(profile[0][:, 0], 0.0)
    height = float(np.quantile(crown, LOW_OF_RIDGE))
    if height <= 0:
        return None
    halves = []
    for values in profile:
        is_low = values < 0.5 * np.minimum(crown, 1.3 * height)[:, None]
        halves.append(np.where(is_low.any(axis=1), is_low.argmax(axis=1), len(offsets)) * PROFILE_STEP)
    half = np.minimum(*halves)
    own = crown <= 1.25 * height
    width = 2 * float(np.quantile(half[own] if own.any() else half, NARROW_OF_RIDGE)) * pitch * wider
    metres = (points + 0.5) * np.array(pitch_m) - np.array(plate_m) / 2
    track = track_through(metres, is_closed=ridge.is_closed, node_m=NODE_SAMPLES * pitch)
    return CurvedLines([track], np.array([[np.clip(width, *WIDTHS_M), max(height, LEAST_M)]]))
