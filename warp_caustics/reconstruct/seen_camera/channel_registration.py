"""Where the channels of a measured caustic lie against each other, and how blurred they are, beside a simulation.

The simulation is of a relief that is still wrong. What is wrong is wrong in all channels alike, so a channel is not
compared with its simulation but with

    expected_c = measured_r + simulated_c - simulated_r,      r the middle channel,

which has its lines where the measured ones are. A shift of all channels together is not looked for: it is that of a
displaced plate.

On own fields with 1 and 3 % of noise from reliefs 1 to 18 um wrong: channels that are not apart are found so to 0.003
px (0.006 at the border of the image), channels 0.3 to 0.6 px apart to 0.006 px (median), 0.03 at most.
"""

import numpy as np
import torch

from warp_caustics.reconstruct.objective import Measurement
from warp_caustics.reconstruct.seen_camera.blur_estimate import Blur, estimated_blur
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera, displacement_px
from warp_caustics.reconstruct.seen_camera.image_window import TAPER_PX, ImageWindow, frequencies, gaussian
from warp_caustics.types import FloatArray

SMOOTHING_PX = 1.0
"""Images are smoothed by this before they are compared: lines are finer than pixels, and what is finer than two cannot
be shifted."""
ERODED_PX = 3
"""Pixels this near to one that does not count do not count either: smoothing brings its value there."""
CUTS = 6
"""Times that a simulation is cut where a camera saturates."""
CUT_ENOUGH = 0.02
"""Change of the blur [px^2] at which that is enough."""
FAR_PX = 1.0
"""Displacement beyond which phase correlation (Kuglin and Hines 1975) is asked first."""
LEAST_PEAK = 7.0
"""Height of a peak of the phase correlation, in its standard deviations over all shifts, from which on it is believed.
Of noise the highest of 512^2 is 5; where a relief hardly shows in its image there is nothing else, and channels were
moved by 7 px for it."""
TURNS = 3
"""Times that channels are moved and compared again, at most."""
TURNED_PX = 1e-4
"""Change of a displacement at which that is enough; the next would be a thousandth of it."""
OUTLIER = 3.0
"""Residuals, in units of their typical size, from which on they count less."""
LEAST_SHIFT_PX = 0.03
"""Channels less apart than this, everywhere in the image, are left where they are."""
LEAST_STRUCTURE = 1e-3
"""Contrast of a channel, measured or simulated, below which it tells nothing: lamp off, or a flat plate."""


@torch.no_grad()
def registered(measurement: Measurement, simulated: torch.Tensor) -> ChannelCamera:
    """The camera of an image.

    A GPU is waited for at most seven times, where no pixel is masked: small images make small kernels, and the host is
    what they wait for.

    Args:
        measurement: what was seen, in units of the radiosity, all pixels; those of weight 0 do not matter.
        simulated: the same of a relief that is nearly right, shape [n_w, m, m].
    """
    channels, pixels = simulated.shape[0], simulated.shape[-1]
    found = ChannelCamera.perfect(channels, pixels)
    # The outermost pixels are faded out altogether.
    inner = measurement.weight[:, 1:-1, 1:-1]
    shares = torch.stack((measurement.weight.mean(dim=(1, 2)), inner.amin(dim=(1, 2))), 1).tolist()
    seen = [c for c, (share, _) in enumerate(shares) if share > 0.5]
    if not seen or pixels < 4 * TAPER_PX:
        return found
    # A list would be sent to the device to choose by.
    part = slice(None) if len(seen) == channels else seen
    window = ImageWindow((measurement.weight[part] > 0).float(), any(shares[c][1] == 0 for c in seen))
    (given, expected), means = window.centred(torch.stack((measurement.irradiance[part], simulated[part])).float())
    contrast = (torch.stack((given, expected)).square() * window.fade).sum(dim=(2, 3)) / window.fade.sum()
    tells = (contrast >= LEAST_STRUCTURE**2).all(dim=0).tolist()
    if not all(tells):
        counts = torch.zeros_like(measurement.weight)
        kept = [c for c, does in zip(seen, tells, strict=True) if does]
        counts[kept] = measurement.weight[kept]
        return registered(Measurement(measurement.irradiance, counts, measurement.noise), simulated)
    transforms, wanted = window.transformed(torch.stack((given, expected)))
    shift, scale = np.zeros((len(seen), 2)), np.zeros(len(seen))
    middle = min(range(len(seen)), key=lambda k: abs(seen[k] - channels // 2))
    if len(seen) > 1:
        others = np.arange(len(seen)) != middle
        prediction = _without(wanted, middle) + (transforms[middle] - wanted[middle])
        shift[others], scale[others] = _displacements(_without(transforms, middle), prediction, _inside(window))
    is_apart = displacement_px(shift, scale, pixels) >= LEAST_SHIFT_PX
    shift[~is_apart], scale[~is_apart] = 0.0, 0.0
    if is_apart.any():
        transforms = _moved(transforms, -torch.as_tensor(shift, device=transforms.device))
    if window.has_gaps:
        brightest = (measurement.irradiance[part] * window.weight).amax(dim=(1, 2))
        blur = _blur_of_saturated(transforms, simulated[part].float(), brightest, window)
    else:
        blur = estimated_blur(transforms, wanted)
    found.shift[seen], found.scale[seen] = shift, scale
    found.blur[seen], found.gain[seen] = blur.std_px(), blur.gain
    given_mean, expected_mean = means.cpu().numpy()
    found.ambient[seen] = given_mean - blur.gain * expected_mean
    return found


def _without(values: torch.Tensor, index: int) -> torch.Tensor:
    """All along the first dimension but one."""
    return torch.cat((values[:index], values[index + 1 :]))


def _inside(window: ImageWindow) -> torch.Tensor | None:
    """1 for pixels away from those that do not count in any channel, shape [m - 2 TAPER_PX]^2; None if all count."""
    if not window.has_gaps:
        return None
    gaps = (window.weight == 0).any(dim=0).float()
    size = 2 * ERODED_PX + 1
    near = torch.nn.functional.max_pool2d(gaps[None, None], size, stride=1, padding=ERODED_PX)[0, 0]
    return _cropped(1 - near)


def _cropped(values: torch.Tensor) -> torch.Tensor:
    """Without the border where images fade out, [..., m, m] to [..., m - 2 TAPER_PX, m - 2 TAPER_PX]."""
    return values[..., TAPER_PX:-TAPER_PX, TAPER_PX:-TAPER_PX]


def _moved(transforms: torch.Tensor, shift: torch.Tensor) -> torch.Tensor:
    """Transforms [B, m, m / 2 + 1] of pictures moved by shift [B, 2] towards larger x and y [px]."""
    kx, ky = frequencies(transforms.shape[-2], transforms.device)
    by_x, by_y = shift.float().unbind(1)
    return transforms * torch.exp(-1j * by_x[:, None, None] * kx) * torch.exp(-1j * by_y[:, None, None] * ky)


def _displacements(
    transforms: torch.Tensor, wanted: torch.Tensor, inside: torch.Tensor | None
) -> tuple[FloatArray, FloatArray]:
    """Shift [B, 2] [px] and scale [B] of pictures against what was expected of them, both of mean 0.

    Args:
        transforms: of the pictures, faded out at the border, shape [B, m, m / 2 + 1].
        wanted: of what was expected of them, same shape.
        inside: 1 where pixels count, without the border, shape [m - 2 TAPER_PX]^2; None if all do.
    """
    pixels, device = transforms.shape[-2], transforms.device
    kx, ky = frequencies(pixels, device)
    smooth = gaussian(pixels, SMOOTHING_PX, device)
    transforms, wanted = transforms * smooth, wanted * smooth
    shift = _coarse(transforms, wanted).double()
    along = (torch.arange(TAPER_PX, pixels - TAPER_PX, device=device) - (pixels - 1) / 2) / (pixels / 2)
    ones = torch.ones(len(shift), along.numel(), along.numel(), device=device)
    growth_px = torch.zeros(len(shift), dtype=torch.float64, device=device)
    along_x, along_y, soften = -1j * kx, -1j * ky, -(kx**2 + ky**2) / 2
    for turn in range(TURNS):
        moved = _moved(transforms, -shift)
        # Half way between both, derivatives are right to second order, and noise of both has no say.
        half = (moved + wanted) / 2
        spectra = torch.stack((along_x * half, along_y * half, soften * half, half, moved - wanted), 1)
        by_x, by_y, softer, brightness, difference = _cropped(torch.fft.irfft2(spectra, s=(pixels, pixels))).unbind(1)
        growth = along * by_x + along[:, None] * by_y
        columns = torch.stack((by_x, by_y, softer, growth, brightness, ones, difference), dim=1).flatten(2)
        solution = _robust(columns, None if inside is None else inside.flatten())
        step = torch.cat((solution[:, :2], (solution[:, 3] - growth_px)[:, None]), 1)
        shift, growth_px = shift + solution[:, :2], solution[:, 3]
        if turn and turn + 1 < TURNS and float(step.abs().max()) < TURNED_PX:
            break
    found = torch.cat((shift, growth_px[:, None] / (pixels / 2)), 1).cpu().numpy()
    return found[:, :2], found[:, 2]


def _robust(columns: torch.Tensor, counts: torch.Tensor | None) -> torch.Tensor:
    """Least squares in which outliers count less, shape [B, C]: of C columns and the values after them [B, C + 1, N].

    ``counts`` [N] is 0 for values that do not; None if all do.
    """
    weight, solution = counts, torch.empty(0)
    eye = torch.eye(columns.shape[1] - 1, dtype=torch.float64, device=columns.device)
    ridge, least = 1 + 1e-9 * eye, 1e-30 * eye
    for last in (False, False, True):
        weighted = columns if weight is None else columns * (weight if weight.ndim == 1 else weight[:, None])
        normal = (weighted @ columns.transpose(1, 2)).double()
        normal, right = normal[:, :-1, :-1], normal[:, :-1, -1:]
        # Without a check, for which a GPU would be waited for: the ridge leaves nothing singular.
        solution = torch.linalg.solve_ex(torch.addcmul(least, normal, ridge), right)[0][..., 0]
        if not last:
            left = columns[:, -1] - (solution[:, None].float() @ columns[:, :-1])[:, 0]
            size = left.abs().mean(1) if counts is None else (left.abs() * counts).sum(1) / counts.sum().clamp_min(1)
            weight = (1 + (left / (OUTLIER * size.clamp_min(1e-12)[:, None])).square()).reciprocal()
            weight = weight if counts is None else weight * counts
    return solution


def _blur_of_saturated(
    transforms: torch.Tensor, simulated: torch.Tensor, brightest: torch.Tensor, window: ImageWindow
) -> Blur:
    """Blur of an image whose lines may be too bright for the camera.

    It lacks their peaks and with them much of what is sharp. So the simulation, blurred by what was found so far, is
    cut at the brightest pixel [n_w] that counts, and compared again. Of a blur of 1 px, 0.75 to 0.85 px are found where
    0.2 % of the pixels are saturated, 0.65 to 0.75 px at 1 %; pixels that are dead here and there do not matter.
    """
    pixels = simulated.shape[-1]
    kx, ky = frequencies(pixels, simulated.device)
    sharp, square = torch.fft.rfft2(simulated), np.zeros(len(simulated))
    for _ in range(CUTS):
        variance = torch.as_tensor(np.maximum(square, 0.0), device=simulated.device).float()[:, None, None]
        soft = torch.exp(-0.5 * variance * kx**2) * torch.exp(-0.5 * variance * ky**2)
        as_seen = torch.fft.irfft2(sharp * soft, s=(pixels, pixels))
        centred, _ = window.centred(as_seen.minimum(brightest[:, None, None]))
        blur = estimated_blur(transforms, window.transformed(centred))
        step, square = blur.square, np.maximum(square, 0.0) + blur.square
        if np.abs(step).max() < CUT_ENOUGH:
            break
    return blur._replace(square=square)


def _coarse(transforms: torch.Tensor, wanted: torch.Tensor) -> torch.Tensor:
    """Shift by whole pixels, shape [B, 2], of the highest peak of the phase correlation; 0 for small ones, or none."""
    pixels = transforms.shape[-2]
    kx, ky = frequencies(pixels, transforms.device)
    square = kx**2 + ky**2
    # What is as large as the image says nothing of places, what is finer than three pixels is noise.
    band = (square / (square + 0.05**2)) * torch.exp(-square)
    cross = transforms * wanted.conj()
    peaks = torch.fft.irfft2(
        band * cross / (cross.abs() + 1e-6 * cross.abs().amax((1, 2), keepdim=True)), s=(pixels, pixels)
    )
    highest, place = peaks.flatten(1).max(dim=1)
    at = torch.stack((place % pixels, place // pixels), dim=1)
    at = torch.where(at >= pixels // 2, at - pixels, at)
    is_peak = highest > LEAST_PEAK * peaks.flatten(1).std(dim=1)
    is_far = (at.abs().amax(dim=1) > FAR_PX) & is_peak
    return torch.where(is_far[:, None], at, 0)
