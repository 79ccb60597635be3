"""Pictures of users with fewer wavelengths or pixels than the run's scene, drawn anew for every visit of a sample.

A reconstruction shows a network what there is: channels without a wavelength of their own show the middle one, noise
and all, and a dispersion of 0 is told for them; an image of fewer pixels is brought to the network's by splines.
Training shows it the same, on the device, which is not waited for. None for pictures means those of the run's scene.
"""

from typing import NamedTuple

import torch
from torch.nn import functional

from nets.told import ToldTable
from nets.training.camera import Camera
from nets.training.picture_config import PictureConfig
from warp_caustics.resampling import regridding_matrix


class Pictures(NamedTuple):
    """Of a batch of B images with n_w channels."""

    missing: torch.Tensor
    """Channels without a wavelength of their own, bool, shape [B, n_w]; never the middle one."""
    is_coarse: torch.Tensor
    """Whether the image had fewer pixels, bool, shape [B]."""


class PictureMaker:
    """Draws such pictures and makes them.

    Args:
        config: how many.
        table: of the network; its scene gives pixels and wavelengths.
        flat: light behind a flat plate, shape [n_w, 1, 1] [W/m^2].
    """

    def __init__(self, config: PictureConfig, table: ToldTable, flat: torch.Tensor):
        self.config, self.table = config, table
        scene, device = table.scene, flat.device
        self.channels, self.middle = scene.n_wavelengths, scene.n_wavelengths // 2
        self.others = [k for k in range(self.channels) if k != self.middle]
        self.dispersion = [table.place(f"dispersion_{k}") for k in self.others]
        self.brightness = flat / flat[self.middle]
        pixels = scene.image_pixels
        self.finer = torch.empty(0)
        if config.coarse_share:
            self.finer = regridding_matrix(pixels // config.coarse_binning, pixels).to(device, torch.float32)

    def drawn(self, count: int, generator: torch.Generator) -> Pictures | None:
        """Of a batch, by the shares; None where all are 0."""
        config, device = self.config, generator.device
        if config.is_off:
            return None
        unit = torch.rand(3, count, generator=generator, device=device)
        is_one = unit[0] < config.one_wavelength_share
        is_two = ~is_one & (unit[0] < config.one_wavelength_share + config.two_wavelengths_share)
        lost = (unit[1] * len(self.others)).long()
        return self._pictures(is_one, is_two, lost, unit[2] < config.coarse_share)

    def fixed(self, count: int, *, is_one: bool = False, is_coarse: bool = False) -> Pictures:
        """A batch of one kind: all of one wavelength, or all coarse."""
        no = torch.zeros(count, dtype=torch.bool, device=self.brightness.device)
        return self._pictures(no | is_one, no, no.long(), no | is_coarse)

    def _pictures(
        self, is_one: torch.Tensor, is_two: torch.Tensor, lost: torch.Tensor, is_coarse: torch.Tensor
    ) -> Pictures:
        missing = torch.zeros(len(is_one), self.channels, dtype=torch.bool, device=is_one.device)
        for number, channel in enumerate(self.others):
            missing[:, channel] = is_one | (is_two & (lost == number))
        return Pictures(missing, is_coarse)

    def bench(self, values: torch.Tensor, pictures: Pictures | None) -> torch.Tensor:
        """Parameters of benches, shape [B, P - 2], as those who have such pictures know them."""
        if pictures is None:
            return values
        values = values.clone()
        for channel, column in zip(self.others, self.dispersion, strict=True):
            values[:, column] = values[:, column].masked_fill(pictures.missing[:, channel], 0.0)
        return values

    def blurs(self, camera: Camera, pictures: Pictures | None) -> Camera:
        """Cameras whose missing channels are blurred as the middle one, which they show."""
        if pictures is None:
            return camera
        middle = camera.blur[:, self.middle, None]
        return camera._replace(blur=torch.where(pictures.missing, middle, camera.blur))

    def noises(self, camera: Camera, pictures: Pictures | None) -> Camera:
        """Cameras whose noise is as large as was said after pixels of coarse images were made one."""
        if pictures is None:
            return camera
        larger = torch.where(pictures.is_coarse, float(self.config.coarse_binning), 1.0)
        return camera._replace(noise=camera.noise * larger)

    def seen(self, images: torch.Tensor, pictures: Pictures | None) -> torch.Tensor:
        """What is left of images that cameras saw, shape [B, n_w, m, m] [W/m^2]."""
        if pictures is None:
            return images
        middle = images[:, self.middle, None] * self.brightness
        images = torch.where(pictures.missing[:, :, None, None], middle, images)
        if not self.config.coarse_share:
            return images
        coarse = functional.avg_pool2d(images, self.config.coarse_binning)
        coarse = self.finer @ coarse @ self.finer.T
        return torch.where(pictures.is_coarse[:, None, None, None], coarse, images)
