"""What a sensor makes of light: electrons that are counted, read, and turned into whole numbers.

    electrons = Poisson(exposure signal / level  N) + dark + Normal(0, read noise),    N the full well
    value = round((black + electrons / N) (2^bits - 1)) / (2^bits - 1),  cut to 0..1

(EMVA Standard 1288, release 4.0, section 2: linear camera model, less the gain that N and the bits imply.)
"""

import torch

from warp_caustics.camera.config import SensorConfig


def exposed(
    signal: torch.Tensor,
    sensor: SensorConfig,
    level: float,
    generator: torch.Generator,
    *,
    hot: torch.Tensor | None = None,
    frames: int = 1,
) -> torch.Tensor:
    """Mean of exposures, as parts of full scale from 0 to 1, shape of ``signal``.

    Args:
        signal: light on the sensor's pixels [W/m^2 behind a flat plate], any shape [..., H, W]; below 0 counts as 0.
        sensor: the sensor.
        level: light [W/m^2] that fills the sensor's ``exposure``.
        generator: of the noise, on the signal's device.
        hot: what pixels show in the dark besides, as parts of full scale, shape [H, W] or of the signal.
        frames: number of exposures; noise differs, light does not.
    """
    charge = (signal * (sensor.exposure / level)).clamp(min=0)
    if hot is not None:
        charge = charge + hot
    if sensor.full_well_electrons is None:
        return read_out(charge, sensor)
    # Beyond four times the full well everything is saturated, and numbers stay within a float's digits.
    expected = charge.clamp(max=4) * sensor.full_well_electrons
    total = torch.zeros_like(expected)
    for _ in range(frames):
        electrons = torch.poisson(expected, generator)
        if sensor.read_noise_electrons > 0:
            drawn = torch.randn(expected.shape, generator=generator, device=expected.device, dtype=expected.dtype)
            electrons = electrons + sensor.read_noise_electrons * drawn
        total += read_out(electrons / sensor.full_well_electrons, sensor)
    return total / frames


def read_out(charge: torch.Tensor, sensor: SensorConfig) -> torch.Tensor:
    """What the converter makes of a charge, both as parts of full scale: offset, steps, and its ends."""
    value = (charge + sensor.black_level).clamp(0, 1)
    if sensor.bits is None:
        return value
    steps = float(2**sensor.bits - 1)
    return torch.round(value * steps) / steps
