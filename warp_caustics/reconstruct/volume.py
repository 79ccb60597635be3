"""Printed volume: the heuristic by which SfC keeps the amount of glass near what was deposited.

One image hardly shows the mean height (a slab looks like a slab), so the volume is what ties it.
"""

import math
from dataclasses import dataclass

import numpy as np
import scipy  # loads its parts when they are first used

from warp_caustics.types import FloatArray

BOX = 5
"""Side of the box mean, in samples: SfC's."""


def relief_volume(heights_m: FloatArray, sample_pitch_m: tuple[float, float]) -> float:
    """Volume of a relief [m^3]: sum of the heights [m], shape [n, n], times the area of a sample."""
    return float(heights_m.sum()) * sample_pitch_m[0] * sample_pitch_m[1]


@dataclass(frozen=True)
class VolumeBand:
    """Pushes a relief's volume into a band around the printed one; leaves it alone inside.

    Attributes:
        volume_m3: printed volume [m^3].
        tolerance: half width of the band, relative.
        gain: gamma, largest relative change of the heights in one call.
    """

    volume_m3: float
    tolerance: float = 0.25
    gain: float = 0.1

    def apply(self, heights_m: FloatArray, mask: FloatArray, sample_pitch_m: tuple[float, float]) -> FloatArray:
        """One step of the heuristic.

        Below the band, V <= d1:  h += mask mean5(h) gamma sin(pi V / d1).
        Above it, V >= d2:        h -= mask mean5(h) gamma sin(pi min(V / d2 - 1, 1/2)).

        The published sine has no minimum: beyond twice d2 it would change sign and push further up.

        Args:
            heights_m: h [m], shape [n, n].
            mask: 1 where glass may be, else 0, shape [n, n].
            sample_pitch_m: distance of samples along x and y [m].

        Returns:
            Heights [m], shape [n, n].
        """
        volume = relief_volume(heights_m, sample_pitch_m)
        lower, upper = (1 - self.tolerance) * self.volume_m3, (1 + self.tolerance) * self.volume_m3
        if lower < volume < upper:
            return heights_m
        if volume <= lower:
            # A negative volume would make the sine negative too, and with the negative mean push up all the same.
            push = math.sin(math.pi * max(volume / lower, -0.5))
        else:
            push = -math.sin(math.pi * min(volume / upper - 1, 0.5))
        mean: FloatArray = scipy.ndimage.uniform_filter(np.asarray(heights_m, float), BOX, mode="nearest")
        return heights_m + mask * mean * self.gain * push
