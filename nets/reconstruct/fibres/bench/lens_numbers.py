"""A point spread as numbers that are found with lines and bench: weights, and the width of the lens before them.

Opposite weights are alike, and what they gain the middle one loses: as they are found by least squares
(:mod:`warp_caustics.reconstruct.seen_camera.spread_estimate`). A lens that is found before the bench makes up for it:
one of 0.65 px in place of 0.7 left 270 squared deviations more beside five lines than the true one, weights and all.
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
LENS_PRIOR, LENS_STEP = 0.1, 0.02
"""Standard deviation of what is believed of a lens's width, and a difference by it, relative to that."""


def count_of(camera: ChannelCamera) -> int:
    """How many numbers there are, weights of all channels and then a lens each: none where no point spread is known."""
    return 0 if camera.spread is None else (PAIRS + 1) * len(camera.blur)


def widened(camera: ChannelCamera, by: FloatArray | float) -> ChannelCamera:
    """The camera with a lens that is so many times as wide, of all channels or of each, shape [n_w]."""
    assert camera.spread is not None
    return dataclasses.replace(camera, spread=dataclasses.replace(camera.spread, lens_px=by * camera.spread.lens_px))


def sharpened(camera: ChannelCamera) -> ChannelCamera:
    """The camera with nothing but the lens, without weights and halos."""
    assert camera.spread is not None
    weights = np.zeros_like(camera.spread.weights)
    weights[:, REACH, REACH] = 1.0
    bare = dataclasses.replace(camera.spread, weights=weights, halos=np.zeros_like(camera.spread.halos))
    return dataclasses.replace(camera, spread=bare)


def derivatives(sharp: torch.Tensor, narrow: torch.Tensor, wide: torch.Tensor) -> Iterator[tuple[int, torch.Tensor]]:
    """Channel, and derivative of its picture by each number in its width, shape [m, m].

    Args:
        sharp: picture by :func:`sharpened`, shape [n_w, m, m].
        narrow: by :func:`widened`, 1 - :data:`LENS_STEP` times, same shape.
        wide: 1 + :data:`LENS_STEP` times.
    """
    pixels = sharp.shape[-1]
    for channel, picture in enumerate(sharp):
        padded = torch.nn.functional.pad(picture[None, None], (REACH,) * 4, mode="replicate")[0, 0]
        for pair in range(PAIRS):
            (y, x), last = divmod(pair, SIDE), SIDE - 1
            one = padded[y : y + pixels, x : x + pixels]
            other = padded[last - y : last - y + pixels, last - x : last - x + pixels]
            yield channel, WEIGHT_WIDTH * (one + other - 2 * picture)
    yield from enumerate(LENS_PRIOR / (2 * LENS_STEP) * (wide - narrow))


def moved(camera: ChannelCamera, step: FloatArray) -> ChannelCamera:
    """The camera with numbers that differ by so many widths, as many as :func:`count_of`; as it is without any."""
    if camera.spread is None or not len(step):
        return camera
    channels = len(camera.blur)
    weights = camera.spread.weights.reshape(channels, SIDE**2).copy()
    sides = WEIGHT_WIDTH * step[: channels * PAIRS].reshape(channels, PAIRS)
    weights[:, :PAIRS] += sides
    weights[:, PAIRS + 1 :] += sides[:, ::-1]
    weights[:, PAIRS] -= 2 * sides.sum(1)
    spread = dataclasses.replace(camera.spread, weights=weights.reshape(camera.spread.weights.shape))
    return widened(dataclasses.replace(camera, spread=spread), np.exp(LENS_PRIOR * step[channels * PAIRS :]))
