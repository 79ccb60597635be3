"""How a camera saw a caustic through colour filters: what lies between a channel's own pixels is no blur.

A channel is sampled at every second pixel only, and what is finer folds over: neither do spectra fall as a blur makes
them, nor is a displaced channel the displaced image of another. So the simulation is displaced and blurred by what was
found so far, sampled by the same filters, and compared again. Displacements as without filters
(:mod:`~warp_caustics.reconstruct.seen_camera.channel_registration`); blur by the power of each channel's own pixels
alone, beside the white floor of their noise, until the next comparison finds none
(:mod:`~warp_caustics.reconstruct.seen_camera.blur_estimate`).
"""

import dataclasses

import numpy as np
import numpy.typing as npt
import torch

from warp_caustics.reconstruct.colour_filters import of_one_filter, through_filters
from warp_caustics.reconstruct.objective import Measurement
from warp_caustics.reconstruct.seen_camera.blur_estimate import LEAST_SQUARE, Blur, estimated_blur
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.reconstruct.seen_camera.channel_registration import registered
from warp_caustics.reconstruct.seen_camera.image_window import TAPER_PX, ImageWindow
from warp_caustics.resampling import blur_matrices, blurred, resampling_matrix
from warp_caustics.types import FloatArray

ROUNDS = 2
"""Of displacements, and of blur beside these."""
BLUR_ROUNDS = 6
"""Comparisons at most; two photos took three to a hundredth of a pixel."""
ENOUGH_PX2 = 0.02
"""Change of a blur's variance [px^2] at which that is enough."""
APART = 2
"""Pixels from one of a filter's to the next."""


@torch.no_grad()
def registered_through_filters(
    measurement: Measurement, simulated: torch.Tensor, own: npt.NDArray[np.bool_]
) -> ChannelCamera:
    """The camera of an image that was taken through colour filters.

    Args:
        measurement: what was seen, with what was made up, in units of the radiosity, all pixels.
        simulated: the same of a relief that is nearly right, as its screen shows it, shape [3, m, m].
        own: True where a channel's own filter lies, shape [3, m, m].
    """
    channels, pixels = simulated.shape[0], simulated.shape[-1]
    found = ChannelCamera.perfect(channels, pixels)
    for _ in range(ROUNDS):
        camera = registered(measurement, through_filters(as_seen(simulated, found), own))
        found = dataclasses.replace(
            camera, shift=found.shift + camera.shift, scale=found.scale + camera.scale, blur=found.blur
        )
        if pixels < 4 * APART * TAPER_PX:
            continue
        sharp, square, error = as_seen(simulated, found.sharp()), np.zeros(channels), np.zeros(channels)
        places = [of_one_filter(each) for each in own]
        seen = [c for c, place in enumerate(places) if float(measurement.weight[c][place].mean()) > 0.5]
        for c in seen:
            square[c], error[c] = blur_of_own_pixels(measurement, sharp[c], c, places[c])
        found = dataclasses.replace(found, blur=_together(square, error, seen))
    return found


def _together(square: FloatArray, error: FloatArray, seen: list[int]) -> FloatArray:
    """Standard deviations [px], shape [n_w]; 0 where there is no blur: told by all channels, for one lens blurs them.

    Args:
        square: variances [px^2], shape [n_w].
        error: standard errors of these, same shape; errors of channels go together.
        seen: channels that tell anything.
    """
    if not seen:
        return np.zeros_like(square)
    mean = Blur(square[seen].mean(keepdims=True), error[seen].mean(keepdims=True), np.ones(1))
    is_told = (mean.std_px() > 0) & (square > LEAST_SQUARE)
    return np.where(is_told, np.sqrt(square), 0.0)


def blur_of_own_pixels(
    measurement: Measurement, sharp: torch.Tensor, channel: int, place: tuple[slice, slice]
) -> tuple[float, float]:
    """Variance of a channel's blur, at least 0, and its standard error [px^2].

    Args:
        measurement: what was seen.
        sharp: the channel's simulation where the camera shows it, shape [m, m].
        channel: which.
        place: rows and columns of its own pixels.
    """
    pixels, device = sharp.shape[-1], sharp.device
    weight = (measurement.weight[channel][place] > 0).float()[None]
    window = ImageWindow(weight, bool((weight == 0).any()))
    measured = window.transformed(window.centred(measurement.irradiance[channel][place][None])[0])
    square, told = 0.0, Blur(np.zeros(1), np.ones(1), np.ones(1))
    for _ in range(BLUR_ROUNDS):
        soft = sharp
        if square > 0:
            soft = blurred(sharp[None], blur_matrices(pixels, np.sqrt([square]), device))[0]
        told = estimated_blur(measured, window.transformed(window.centred(soft[place][None])[0]))
        step = APART**2 * float(told.square[0])
        square = max(square + step, 0.0)
        if abs(step) < ENOUGH_PX2:
            break
    return square, APART**2 * float(told.error[0])


def as_seen(simulated: torch.Tensor, camera: ChannelCamera) -> torch.Tensor:
    """Channels displaced and blurred as a camera shows them before its filters, shape [n_w, m, m]."""
    if camera.displaces:
        shift = torch.as_tensor(np.array(camera.shift))
        scale = torch.as_tensor(np.array(camera.scale))[:, None].expand(-1, 2)
        along = resampling_matrix(camera.pixels, shift, scale).to(simulated)
        simulated = along[:, 1] @ simulated @ along[:, 0].transpose(-1, -2)
    if camera.blurs:
        simulated = blurred(simulated, blur_matrices(camera.pixels, camera.blur, simulated.device))
    return simulated
