"""Small copies of large images, for stages to show."""

from typing import Any

import numpy as np
import numpy.typing as npt

from warp_caustics.capture.distortion import Points

MAX_PIXELS = 1_000_000


def preview(image: npt.NDArray[np.floating[Any]]) -> npt.NDArray[np.float32]:
    """An image [C, H, W] as float32, blocks averaged until it has at most MAX_PIXELS pixels."""
    k = reduction(image.shape[1:])
    if k == 1:
        return np.array(image, dtype=np.float32)
    channels, height, width = image.shape
    part = image[:, : height // k * k, : width // k * k]
    blocks = part.reshape(channels, height // k, k, width // k, k)
    return np.asarray(blocks.mean(axis=(2, 4)), dtype=np.float32)


def reduction(shape: tuple[int, ...]) -> int:
    """Pixels per side of a block that becomes one pixel of the preview of an image [H, W]."""
    k = 1
    while (shape[0] // k) * (shape[1] // k) > MAX_PIXELS:
        k += 1
    return k


def preview_marks(marks_px: Points, shape: tuple[int, ...]) -> Points:
    """Marks (x, y) of an image [H, W] in the pixels of its preview, shape [N, 2]."""
    k = reduction(shape)
    return (marks_px + 0.5) / k - 0.5
