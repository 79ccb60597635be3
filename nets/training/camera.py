"""What a camera does to a caustic, drawn anew for every visit of a training sample.

Networks read heights from the dispersion of the glass, hundredths of a pixel between the channels; an image in which
they lie a tenth of a pixel apart, as lateral colour and the mosaic of every colour camera make it, means nothing to a
network that has only seen perfect ones. In the order in which light meets them:

1. channels blurred (PSF: Gaussian), scaled and shifted, each its own; the middle channel keeps its place, because a
   plate that is displaced looks the same as an image that is;
2. light that is uneven, to second order; light that is not from the lamp;
3. channels that see each other's light, gains, exposure;
4. noise of any power of the signal, weakly correlated between neighbours.
"""

import math
from typing import NamedTuple

import torch

from nets.training.config import LARGEST_BLUR_PX, CameraConfig
from warp_caustics.camera.radiometry import mixed, uneven_light
from warp_caustics.resampling import resampled, spline_reach

DARKEST = 1e-3
"""Relative irradiance below which noise no longer falls."""
REACH = spline_reach(LARGEST_BLUR_PX)


class Camera(NamedTuple):
    """Cameras of a batch of B images of n_w channels, on their device."""

    shift: torch.Tensor
    """Of the picture towards larger x and y [px], shape [B, n_w, 2]."""
    scale: torch.Tensor
    """Magnification about the middle, less 1, shape [B, n_w]."""
    blur: torch.Tensor
    """Standard deviation of the PSF [px], shape [B, n_w]."""
    light: torch.Tensor
    """Coefficients of x, y, x^2 - 1/3, x y, y^2 - 1/3 in the unevenness, x and y from -1 to 1; shape [B, n_w, 5]."""
    ambient: torch.Tensor
    """Added light, relative to a flat plate's, shape [B, n_w]."""
    mixing: torch.Tensor
    """Share of each channel's light in each channel's signal, and gain; shape [B, n_w, n_w]."""
    noise: torch.Tensor
    """Standard deviation where it is as bright as behind a flat plate, relative, shape [B]."""
    power: torch.Tensor
    """p of noise ~ signal^p: 0 (read-out) over 1/2 (photons) to 1 (fixed pattern), shape [B]."""
    correlation: torch.Tensor
    """Weight of a neighbour's noise beside a pixel's own, shape [B]."""


def draw_cameras(config: CameraConfig, count: int, channels: int, generator: torch.Generator) -> Camera:
    """Cameras of a batch.

    Each image has a strength of its own for each of these effects, so that few have all in full.

    Args:
        config: largest values.
        count: images.
        channels: n_w.
        generator: on the images' device.
    """
    device = generator.device

    def uniform(*shape: int) -> torch.Tensor:
        return torch.rand(*shape, generator=generator, device=device)

    def signed(*shape: int) -> torch.Tensor:
        return 2 * uniform(*shape) - 1

    worn = (uniform(count) >= config.clean_share).float()  # [B]: 0 for the images that are nearly clean
    strength = uniform(count, 3) * worn[:, None]
    # Any direction, any distance, red and blue each its own.
    angle, distance = 2 * math.pi * uniform(count, channels), config.shift_px * uniform(count, channels)
    shift = torch.stack((torch.cos(angle), torch.sin(angle)), dim=2) * (distance * worn[:, None])[:, :, None]
    scale = config.scale * strength[:, 0, None] * signed(count, channels)
    shift[:, channels // 2], scale[:, channels // 2] = 0.0, 0.0
    # Half of the lenses blur all channels alike, the others each by itself.
    own, alike = uniform(count, channels), (uniform(count, 1) < 0.5).float()
    blur = config.blur_px * worn[:, None] * (alike * own[:, :1] * (0.85 + 0.15 * own) + (1 - alike) * own)
    # Most of the unevenness is the lamp's, some of it each channel's own.
    coefficients = (signed(count, 1, 5) + 0.3 * signed(count, channels, 5)) / 1.3
    light = config.unevenness * strength[:, 1, None, None] * coefficients
    ambient = config.ambient * (uniform(count, 1) * worn[:, None]) * (0.5 + 0.5 * uniform(count, channels))
    mixed = config.mixing * strength[:, 2, None, None] * uniform(count, channels, channels)
    mixed = mixed * (1 - torch.eye(channels, device=device))
    mixing = mixed + torch.diag_embed(1 - mixed.sum(dim=2))
    gain = 1 + config.exposure * signed(count, 1) + config.gain * worn[:, None] * signed(count, channels)
    level = uniform(count)
    noise = torch.where(worn > 0, config.noise * level**2, config.clean_noise * level)
    return Camera(
        shift,
        scale,
        blur,
        light,
        ambient,
        mixing * gain[:, :, None],
        noise,
        uniform(count),
        config.correlation * uniform(count) * worn,
    )


def seen(
    images: torch.Tensor,
    flat: torch.Tensor,
    camera: Camera,
    generator: torch.Generator,
    places: tuple[torch.Tensor, torch.Tensor] | None = None,
) -> torch.Tensor:
    """Images as cameras see them.

    Args:
        images: irradiance, shape [B, n_w, m, m] [W/m^2].
        flat: of a flat plate, shape [n_w, 1, 1] [W/m^2].
        camera: of each image.
        generator: of the noise, on the images' device.
        places: where pictures are moved afterwards, shift [px], shape [B, n_w, 2], and magnification less 1, shape
            [B, n_w]; None for nowhere. It is one resampling: uneven light and noise are those of the moved picture.
    """
    shift, scale = camera.shift, camera.scale
    if places is not None:
        shift, scale = shift * (1 + places[1])[:, :, None] + places[0], (1 + scale) * (1 + places[1]) - 1
    relative = resampled(images, shift, scale, camera.blur, REACH) / flat
    relative = relative * uneven_light(camera.light, images.shape[-1]) + camera.ambient[:, :, None, None]
    signal = mixed(relative, camera.mixing)
    return flat * (signal + _noise(signal, camera, generator))


def noisy(images: torch.Tensor, flat: torch.Tensor, noise: float, generator: torch.Generator) -> torch.Tensor:
    """Images with photon noise of one level, relative to the light of a flat plate; shapes as of :func:`seen`."""
    scale = flat * (images / flat).clamp(min=DARKEST).sqrt()
    return images + noise * scale * torch.randn(images.shape, generator=generator, device=images.device)


def _noise(signal: torch.Tensor, camera: Camera, generator: torch.Generator) -> torch.Tensor:
    def of_image(values: torch.Tensor) -> torch.Tensor:
        return values[:, None, None, None]

    white = torch.randn(signal.shape, generator=generator, device=signal.device)
    weight = of_image(camera.correlation)
    unit = (white + weight * (white.roll(1, -1) + white.roll(1, -2))) / (1 + 2 * weight**2).sqrt()
    return of_image(camera.noise) * signal.clamp(min=DARKEST) ** of_image(camera.power) * unit
