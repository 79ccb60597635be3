"""What lies on a sensor and what is wrong with it: grains of dust, and pixels that shine in the dark."""

import torch

from warp_caustics.camera.config import SensorConfig

SOFT_PX = 1.0
"""Over which a grain's shadow fades; dust does not lie in focus."""


def dust(
    sensor: SensorConfig, grains: int, height: int, width: int, generator: torch.Generator, dtype: torch.dtype
) -> torch.Tensor:
    """Part of the light that grains let through, shape [H, W]: round shadows, anywhere.

    Args:
        sensor: gives ranges of radius and depth, in which both are uniform.
        grains: their number.
        height: H.
        width: W.
        generator: on the device of the result.
        dtype: of the result.
    """
    device = generator.device
    passed = torch.ones(height, width, device=device, dtype=dtype)
    drawn = torch.rand(grains, 4, generator=generator, device=device, dtype=dtype).cpu().tolist()
    for at_x, at_y, size, dark in drawn:
        x, y = at_x * width - 0.5, at_y * height - 0.5
        radius = sensor.dust_radius_px[0] + size * (sensor.dust_radius_px[1] - sensor.dust_radius_px[0])
        depth = sensor.dust_depth[0] + dark * (sensor.dust_depth[1] - sensor.dust_depth[0])
        reach = radius + SOFT_PX
        rows = slice(max(0, int(y - reach)), max(0, int(y + reach) + 2))
        columns = slice(max(0, int(x - reach)), max(0, int(x + reach) + 2))
        part = passed[rows, columns]
        along_y = torch.arange(rows.start, rows.start + part.shape[0], device=device, dtype=dtype) - y
        along_x = torch.arange(columns.start, columns.start + part.shape[1], device=device, dtype=dtype) - x
        distance = torch.sqrt(along_y[:, None] ** 2 + along_x[None, :] ** 2)
        inside = ((radius - distance) / SOFT_PX + 0.5).clamp(0, 1)
        passed[rows, columns] = part * (1 - depth * inside)
    return passed


def hot_pixels(
    sensor: SensorConfig, shape: tuple[int, ...], generator: torch.Generator, dtype: torch.dtype
) -> torch.Tensor:
    """What pixels show without light, as parts of full scale, 0 for most; of a sensor of ``shape``.

    Where the sensor has no mosaic a pixel is one of a channel.
    """
    device = generator.device
    pixels = torch.Size(shape).numel()
    count = min(sensor.hot_pixels, pixels)
    at = torch.randperm(pixels, generator=generator, device=device)[:count]
    low, high = sensor.hot_level
    values = torch.zeros(pixels, device=device, dtype=dtype)
    values[at] = low + (high - low) * torch.rand(count, generator=generator, device=device, dtype=dtype)
    return values.reshape(shape)
