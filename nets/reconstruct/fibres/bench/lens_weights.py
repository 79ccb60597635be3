"""Weights of a point spread as numbers that are found with lines and bench.

Opposite weights are alike, and what they gain the middle one loses: as they are found by least squares
(:mod:`warp_caustics.reconstruct.seen_camera.spread_estimate`). A lens that is found before the bench makes up for it.
"""

import dataclasses
from collections.abc import Iterator

import numpy as np
import torch

from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.reconstruct.seen_camera.point_spread import REACH
from warp_caustics.reconstruct.seen_camera.spread_estimate import WEIGHT_WIDTH
from warp_caustics.types import FloatArray

SIDE = 2 * REACH + 1
PAIRS = SIDE**2 // 2
"""Of opposite weights, of one channel."""


def count_of(camera: ChannelCamera) -> int:
    """How many numbers there are: none of a camera whose point spread is not known."""
    return 0 if camera.spread is None else PAIRS * len(camera.blur)


def sharpened(camera: ChannelCamera) -> ChannelCamera:
    """The camera with nothing but the lens, without weights and halos."""
    assert camera.spread is not None
    weights = np.zeros_like(camera.spread.weights)
    weights[:, REACH, REACH] = 1.0
    bare = dataclasses.replace(camera.spread, weights=weights, halos=np.zeros_like(camera.spread.halos))
    return dataclasses.replace(camera, spread=bare)


def derivatives(sharp: torch.Tensor) -> Iterator[tuple[int, torch.Tensor]]:
    """Channel, and derivative of its picture by each number in its width, shape [m, m].

    Args:
        sharp: picture by :func:`sharpened`, shape [n_w, m, m].
    """
    pixels = sharp.shape[-1]
    for channel, picture in enumerate(sharp):
        padded = torch.nn.functional.pad(picture[None, None], (REACH,) * 4, mode="replicate")[0, 0]
        for pair in range(PAIRS):
            (y, x), last = divmod(pair, SIDE), SIDE - 1
            one = padded[y : y + pixels, x : x + pixels]
            other = padded[last - y : last - y + pixels, last - x : last - x + pixels]
            yield channel, WEIGHT_WIDTH * (one + other - 2 * picture)


def moved(camera: ChannelCamera, step: FloatArray) -> ChannelCamera:
    """The camera with weights that differ by so many widths, shape [n_w * PAIRS]; as it is where there are none."""
    if camera.spread is None or not len(step):
        return camera
    weights = camera.spread.weights.reshape(-1, SIDE**2).copy()
    sides = WEIGHT_WIDTH * step.reshape(-1, PAIRS)
    weights[:, :PAIRS] += sides
    weights[:, PAIRS + 1 :] += sides[:, ::-1]
    weights[:, PAIRS] -= 2 * sides.sum(1)
    spread = dataclasses.replace(camera.spread, weights=weights.reshape(camera.spread.weights.shape))
    return dataclasses.replace(camera, spread=spread)
