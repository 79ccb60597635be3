"""The measured image with its channels where the middle one lies."""

import dataclasses

import numpy as np
import scipy  # loads its parts when they are first used
import torch

from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.colour_filters import moved_pixels
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.resampling import resampling_matrix
from warp_caustics.types import FloatArray

SPOILED = 0.1
"""Share of a resampled pixel that may come from pixels that do not count."""
_NEIGHBOURS = 5
"""Size of the square that stands in for pixels that do not count."""


def repaired(image: CausticImage) -> FloatArray:
    """Irradiance [n_w, m, m] whose pixels that do not count take the mean of their neighbours that do.

    Or stay, if brighter: saturated ones tell the least of what was there.
    """
    values = np.asarray(image.irradiance, dtype=np.float64)
    if image.mask is None or image.mask.all():
        return values
    counts, size = image.mask.astype(np.float64), (1, _NEIGHBOURS, _NEIGHBOURS)
    weight = scipy.ndimage.uniform_filter(counts, size)
    mean = scipy.ndimage.uniform_filter(values * counts, size) / np.maximum(weight, 1e-9)
    return np.where(image.mask, values, np.maximum(values, mean))


def channels_together(image: CausticImage, camera: ChannelCamera, device: torch.device | str) -> CausticImage:
    """The image with all channels where the middle one lies; blur stays.

    Noise of pixels that are means of others is less, by a sixth at half a pixel, and is told so: a picture that was
    brought back from another size leaves a twelfth less of an image, by its noise alone, than a lamp nearby.

    Args:
        image: what the camera saw.
        camera: how far channels are apart.
        device: where to compute.
    """
    values, mask = repaired(image), image.mask
    irradiance = np.array(values)
    kept = None if mask is None else mask.copy()
    own = None if image.own is None else image.own.copy()
    noise = None if image.noise_std is None else np.array(image.noise_std, np.float64)
    pixels = values.shape[-1]
    for channel, ((x, y), scale) in enumerate(zip(camera.shift, camera.scale, strict=True)):
        if x == y == scale == 0:
            continue
        moved = torch.tensor((x, y), dtype=torch.float64) / -(1 + scale)
        back = torch.full_like(moved, 1 / (1 + scale) - 1)
        along_x, along_y = resampling_matrix(pixels, moved, back).to(device)
        picture = torch.as_tensor(values[channel], device=device)
        irradiance[channel] = (along_y @ picture @ along_x.T).cpu().numpy()
        if noise is not None:
            noise[channel] *= noise_that_stays(along_x) * noise_that_stays(along_y)
        if own is not None:
            own[channel] = moved_pixels(own[channel], (x, y), scale)
        if kept is not None and mask is not None:
            gaps = torch.as_tensor(~mask[channel], dtype=torch.float64, device=device)
            kept[channel] = (along_y.abs() @ gaps @ along_x.abs().T < SPOILED).cpu().numpy()
    return CausticImage(irradiance, noise, kept, own, image.size)


def noise_that_stays(rows: torch.Tensor) -> float:
    """Standard deviation of white noise after a resampling along one axis, shape [m, m], over that before.

    Root mean square over the pixels.
    """
    return float(rows.square().sum(dim=-1).mean().sqrt())


def of_size(image: CausticImage, size: float, device: torch.device | str) -> CausticImage:
    """The image so many times as large about its middle; 1 leaves it as it is.

    Args:
        image: what the camera saw.
        size: above 1/2.
        device: where to compute.
    """
    if size == 1:
        return image
    channels, pixels = image.irradiance.shape[0], image.irradiance.shape[-1]
    camera = ChannelCamera.perfect(channels, pixels)
    resampled = channels_together(image, dataclasses.replace(camera, scale=np.full(channels, 1 / size - 1)), device)
    return dataclasses.replace(resampled, size=image.size / size)
