"""Sensors of a batch, each with numbers of its own: what :mod:`warp_caustics.camera.photographs` does for one photo.

The same model on the same light; noise is drawn by kernels from the key of each photo, so that it depends neither on
the batch nor on torch's generators. Ambient light counts as the lamp's, and dark frames are dark.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import torch
import warp as wp

from warp_caustics.camera.sensor_kernels import FLAT_SPECKLE, SPECKLE, sensor_kernels
from warp_caustics.chunked import warp_array, warp_stream
from warp_caustics.kernels.runtime import start_warp
from warp_caustics.resampling import blur_reach, gaussian_kernel

KEY_BITS = 26
"""Of each of the two words of a photo's key."""


@dataclass(frozen=True)
class SensorLimits:
    """What photos of a batch, and of all batches of a data set, have in common.

    Attributes:
        largest_speckle_px: width of the widest speckle; 0 where there is none.
        most_grains: settled and fresh ones together.
        dust_radius_px: range of a grain's radius [px].
        dust_depth: range of the light that it takes.
        hot_level: range of a hot pixel's level, as part of full scale.
    """

    largest_speckle_px: float = 0.0
    most_grains: int = 0
    dust_radius_px: tuple[float, float] = (1.0, 4.0)
    dust_depth: tuple[float, float] = (0.1, 0.6)
    hot_level: tuple[float, float] = (0.02, 0.5)


class Sensors(NamedTuple):
    """Sensors of B photos, on their device."""

    numbers: torch.Tensor
    """Exposure, full well (0: light is no quanta) and read noise [electrons], calibration frames, black level, steps
    of the converter, speckle contrast, settled and fresh grains, hot pixels; float32, shape [B, 10]."""
    speckle_width_px: torch.Tensor
    """Shape [B]."""
    keys: torch.Tensor
    """Two words of each photo, int32, shape [B, 2]."""


class Frames(NamedTuple):
    """Parts of full scale, shape [B, C, H, W]; dark and flat frames are empty where none were asked for."""

    photo: torch.Tensor
    dark: torch.Tensor
    flat: torch.Tensor


def keys_of(seeds: Sequence[int] | npt.NDArray[np.float64]) -> npt.NDArray[np.int32]:
    """Keys of photos from whole numbers below 2^52, shape [B, 2]."""
    whole = np.asarray(seeds, dtype=np.float64).astype(np.int64)
    return np.stack([whole & (2**KEY_BITS - 1), whole >> KEY_BITS], axis=1).astype(np.int32)


def electrons_of(
    noise: npt.NDArray[np.float64], read_share: npt.NDArray[np.float64], exposure: npt.NDArray[np.float64]
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Full well and read noise [electrons] that make flat light as noisy as wanted.

    Of N electrons of flat light and a read noise r the relative variance is (N + r^2) / N^2.

    Args:
        noise: standard deviation over mean of flat light; 0 gives a full well of 0, no quanta.
        read_share: of that variance which is reading's, below 1.
        exposure: part of full scale that flat light fills.
    """
    quiet = noise <= 0
    variance = np.where(quiet, 1.0, noise) ** 2
    flat = 1 / (variance * (1 - read_share))
    read = np.sqrt(read_share * variance) * flat
    return np.where(quiet, 0.0, flat / exposure), np.where(quiet, 0.0, read)


def exposed_batch(
    signal: torch.Tensor, lit: torch.Tensor | None, level: float, sensors: Sensors, limits: SensorLimits
) -> Frames:
    """Photos of light on the sensor, and their dark and flat frames.

    Args:
        signal: behind plates [W/m^2 behind a flat plate], float32, shape [B, C, H, W].
        lit: behind flat plates, same shape; None: no dark and flat frames.
        level: light [W/m^2] that fills the sensors' exposure.
        sensors: of these photos.
        limits: of all of them.
    """
    start_warp()
    kernels, device = sensor_kernels(), wp.device_from_torch(signal.device)
    count, _, height, width = signal.shape
    empty = signal.new_empty(0, 0, 0, 0)
    photo = torch.empty_like(signal)
    dark, flat = (empty, empty) if lit is None else (torch.empty_like(signal), torch.empty_like(signal))
    grains = signal.new_zeros(count, max(1, limits.most_grains), 4)
    with warp_stream(signal.device):
        keys = warp_array(sensors.keys)
        if limits.most_grains:
            wp.launch(
                kernels.place_grains,
                dim=(count, limits.most_grains),
                inputs=[
                    keys, float(width), float(height), wp.vec2(*limits.dust_radius_px), wp.vec2(*limits.dust_depth)
                ],
                outputs=[warp_array(grains)],
                device=device,
            )  # fmt: skip
        speckles = [
            _speckle(sensors, tuple(signal.shape), limits.largest_speckle_px, purpose)
            if limits.largest_speckle_px > 0 and (purpose == SPECKLE or lit is not None)
            else empty
            for purpose in (SPECKLE, FLAT_SPECKLE)
        ]
        wp.launch(
            kernels.expose,
            dim=(count, height, width),
            inputs=[
                keys,
                warp_array(sensors.numbers.contiguous()),
                warp_array(signal.contiguous()),
                warp_array(signal if lit is None else lit.contiguous()),
                warp_array(speckles[0]),
                warp_array(speckles[0] if lit is None else speckles[1]),
                warp_array(grains),
                level,
                wp.vec2(*limits.hot_level),
            ],
            outputs=[warp_array(photo), warp_array(dark), warp_array(flat)],
            device=device,
        )
    return Frames(photo, dark, flat)


def _speckle(sensors: Sensors, shape: tuple[int, ...], largest_px: float, purpose: int) -> torch.Tensor:
    """Gaussian fields of standard deviation 1 and each photo's width, shape of the photos."""
    kernels, device = sensor_kernels(), wp.device_from_torch(sensors.keys.device)
    count, channels, height, width = shape
    reach = blur_reach(largest_px)
    taps = gaussian_kernel(sensors.speckle_width_px, reach)
    taps = (taps / taps.square().sum(dim=-1, keepdim=True).sqrt()).contiguous()
    new = sensors.numbers.new_empty
    tall, wide = height + 2 * reach, width + 2 * reach
    noise, rows, field = new(count, channels, tall, wide), new(count, channels, tall, width), new(shape)
    for kernel, inputs, outputs in (
        (kernels.white, [warp_array(sensors.keys), purpose], noise.view(count, -1)),
        (kernels.filter_columns, [warp_array(noise), warp_array(taps)], rows),
        (kernels.filter_rows, [warp_array(rows), warp_array(taps)], field),
    ):
        wp.launch(kernel, dim=tuple(outputs.shape), inputs=inputs, outputs=[warp_array(outputs)], device=device)
    return field
