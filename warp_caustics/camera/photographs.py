"""Frames as a camera writes them: of a plate, of a plate without relief, and with the light off.

    photo = D [ exposed(mosaic(speckle dust S(E))) ],     S the camera's signal, D demosaicing

Dust and hot pixels are the camera's own and the same in all frames; speckle and noise are of each, and so is dust that
fell after the flat frame was taken.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import torch

from warp_caustics.camera.config import SensorConfig
from warp_caustics.camera.defects import dust, hot_pixels
from warp_caustics.camera.exposure import exposed
from warp_caustics.camera.mosaic import demosaicked, mosaicked
from warp_caustics.camera.operator import Camera
from warp_caustics.camera.speckle import speckle
from warp_caustics.errors import InputError

FULL_SCALE = 65535
"""Of the files: converters with fewer bits are written with the same full scale, as raw converters do."""
MOST_SATURATED = 0.5
"""Share of the window that may be saturated before a photo is none."""
LEAST_COUNTS = 4.0
"""Steps of the converter that a flat plate's light must fill."""


class Photographs(NamedTuple):
    """Frames of one camera: counts of 16 bits, shape [C, H, W] each."""

    photo: npt.NDArray[np.uint16]
    """Of the plate."""
    dark: npt.NDArray[np.uint16]
    """With the light off."""
    flat: npt.NDArray[np.uint16]
    """Of a plate without relief."""
    saturated: tuple[float, ...]
    """Share of the photo's pixels at full scale, of each channel."""


def photographs(camera: Camera, image: torch.Tensor, flat: torch.Tensor, seed: int) -> Photographs:
    """Photo, dark and flat frame.

    Args:
        camera: on the images' device, of float32 or float64.
        image: irradiance behind the plate [W/m^2], shape [n_w, m, m].
        flat: irradiance behind a plate without relief, same shape.
        seed: of all that is drawn; the same on one kind of device.

    Raises:
        InputError: a photo that shows nothing, or is saturated in more than half of its window.
    """
    sensor, form = camera.config.sensor, camera.form
    device, dtype = image.device, image.dtype

    def stream(purpose: int) -> torch.Generator:
        """Of its own for each purpose, so that switching one effect leaves the others as they are."""
        return torch.Generator(device).manual_seed((seed * 16 + purpose) % 2**63)

    level = float(camera.flat.max())
    height, width = form.frame.height, form.frame.width
    shape = (height, width) if form.mosaic is not None else (len(camera.parameters.gain), height, width)
    hot = hot_pixels(sensor, shape, stream(0), dtype) if sensor.hot_pixels else None
    settled = dust(sensor, sensor.dust_grains, height, width, stream(1), dtype)
    fresh = dust(sensor, sensor.fresh_dust_grains, height, width, stream(2), dtype)

    def taken(signal: torch.Tensor, generator: torch.Generator, frames: int) -> torch.Tensor:
        raw = signal if form.mosaic is None else mosaicked(signal, form.mosaic)
        value = exposed(raw, sensor, level, generator, hot=hot, frames=frames)
        return value if form.mosaic is None else demosaicked(value, form.mosaic)

    def speckled(signal: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
        if sensor.speckle_contrast == 0:
            return signal
        factors = speckle(
            tuple(signal.shape), sensor.speckle_contrast, sensor.speckle_width_px, generator, signal.dtype
        )
        return signal * factors

    with torch.no_grad():
        lit = camera.signal(flat)
        _check_light(lit, sensor, level)
        photo = taken(speckled(camera.signal(image), stream(3)) * settled * fresh, stream(4), sensor.photo_frames)
        flat_frame = taken(speckled(lit, stream(5)) * settled, stream(6), sensor.calibration_frames)
        room = torch.zeros_like(image)
        off = camera.signal(room) if camera.config.ambient_in_dark else torch.zeros_like(lit)
        dark_frame = taken(off * settled, stream(7), sensor.calibration_frames)
    _check_saturation(photo, lit, sensor)
    at_end = tuple(float(share) for share in (photo >= 1).to(torch.float64).mean(dim=(-2, -1)))
    return Photographs(in_counts(photo), in_counts(dark_frame), in_counts(flat_frame), at_end)


def in_counts(value: torch.Tensor) -> npt.NDArray[np.uint16]:
    """Whole numbers of 16 bits from parts of full scale, same shape."""
    counts: npt.NDArray[np.uint16] = (
        np.rint(value.double().cpu().numpy() * FULL_SCALE).clip(0, FULL_SCALE).astype(np.uint16)
    )
    return counts


def _check_light(lit: torch.Tensor, sensor: SensorConfig, level: float) -> None:
    """Refuse a camera for which the light of a flat plate is less than a few steps of its converter, or too much."""
    shares = lit.amax(dim=(-2, -1)) * (sensor.exposure / level)
    steps = 2 ** (sensor.bits or 16) - 1
    # A wavelength that the lamp does not have is not the camera's fault.
    faintest, brightest = float(torch.where(shares > 0, shares, torch.inf).min()), float(shares.max())
    if faintest * steps < LEAST_COUNTS:
        raise InputError(
            f"the camera sees nothing: a flat plate's light fills {faintest * steps:.2g} of {steps} steps in the "
            f"faintest channel (limit {LEAST_COUNTS:g}); raise gain or sensor.exposure "
            f"{LEAST_COUNTS / (faintest * steps):.2g} times, or sensor.bits"
        )
    if brightest + sensor.black_level > 1:
        raise InputError(
            f"a flat plate saturates the camera: its light fills {brightest:.3g} of full scale in the brightest "
            f"channel (limit {1 - sensor.black_level:g}); lower gain or sensor.exposure {10 * brightest:.2g} times"
        )


def _check_saturation(photo: torch.Tensor, lit: torch.Tensor, sensor: SensorConfig) -> None:
    """Refuse a photo of which more than half of what is lit is at full scale."""
    for channel, (values, light) in enumerate(zip(photo, lit, strict=True)):
        window = light > light.amax() / 2
        share = float((values >= 1)[window].to(torch.float64).mean())
        if share > MOST_SATURATED:
            raise InputError(
                f"channel {channel} is saturated in {share:.0%} of the window (limit {MOST_SATURATED:.0%}); "
                f"lower sensor.exposure from {sensor.exposure:g}, for example to {sensor.exposure / 10:.2g}"
            )
