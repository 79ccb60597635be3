"""Pictures of another size than the plate's: of a camera that was told wrong corners, or of light that converges.

A lamp at the distance L = 1 / v enlarges a picture by A = 1 + D v, D = d / n + g / n_o the way of light through base
and gap (:mod:`~warp_caustics.found_bench.thin_relief`), and so a picture that is too large looks as of a lamp nearby.
Not quite: what is higher by h is enlarged by D + h / n, and the lamp leaves as much of an image of high lines as tells
both apart. So of a picture light from straight above is simulated, and made A times as large. Below v = 0 it stands
for light that converges as well, which no point source makes; heights differ by no more than 1 - A of themselves.
"""

import torch

from warp_caustics.resampling import resampled, spline_reach
from warp_caustics.scene import Scene
from warp_caustics.way_of_light import way_of_light_m

SMALLEST = 0.97
"""A of the smallest picture that is looked for: corners that are wrong by fifteen thousandths of the plate."""


def lowest_vergence(scene: Scene) -> float:
    """v at which the picture is :data:`SMALLEST` [1/m]."""
    return (SMALLEST - 1) / way_of_light_m(scene)


def picture_size(scene: Scene, vergence_per_m: float) -> float:
    """A of a picture on a bench whose light is parallel.

    Args:
        scene: the bench, whose light is parallel.
        vergence_per_m: v that it looks like.
    """
    return 1 + way_of_light_m(scene) * vergence_per_m


def brought_back(scene: Scene, vergence_per_m: float, as_of_per_m: float) -> tuple[float, float]:
    """Vergence to simulate, and a factor of its picture's size, for a picture brought back from that of another one.

    Brought back means 1 / A(as_of) times as large: then A(v) / A(as_of) is the size of what is looked at. Above 1 it is
    that of a lamp nearby, which can be simulated; below, parallel light's and a factor.

    Args:
        scene: the bench, whose light is parallel.
        vergence_per_m: v.
        as_of_per_m: that of the picture which was brought back.
    """
    way = way_of_light_m(scene)
    size = (1 + way * vergence_per_m) / (1 + way * as_of_per_m)
    return ((size - 1) / way, 1.0) if size >= 1 else (0.0, size)


def enlarged(images: torch.Tensor, size: float) -> torch.Tensor:
    """Pictures so many times as large about their middle; what comes in from beyond the border is mirrored.

    Args:
        images: of even light 1 or of its changes, which a size does not make brighter, shape [..., m, m].
        size: 1 leaves them as they are.
    """
    if size == 1:
        return images
    flat = images.reshape(-1, *images.shape[-2:])
    zero = images.new_zeros(())
    moved = resampled(flat, images.new_zeros(2), zero + (size - 1), zero, spline_reach(0.0))
    return moved.reshape(images.shape)
