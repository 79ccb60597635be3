"""One wavelength of an image: it tells which lines there are, and nearly where, for a part of the time of all."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from nets.reconstruct.fibres.image.image_fit import FINE_PHOTONS_PER_PIXEL, METRIC_PHOTONS_PER_PIXEL, ImageFit
from warp_caustics.prints.model import LineModel
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.scene import Scene


def clearest_wavelength(image: CausticImage, scene: Scene) -> int:
    """Number of the wavelength that shows most: most pixels that count, then the least noise, then the middle."""
    count = scene.n_wavelengths
    radiosity = np.asarray(scene.radiosity_W_m2, dtype=np.float64)
    noise = np.zeros(count) if image.noise_std is None else np.asarray(image.noise_std) / np.maximum(radiosity, 1e-30)

    def rank(channel: int) -> tuple[float, float, int]:
        seen = 1.0 if image.mask is None else float(np.mean(image.mask[channel]))
        return -round(seen, 2), round(float(noise[channel]), 4), abs(channel - count // 2)

    return min((channel for channel in range(count) if radiosity[channel] > 0), key=rank)


def of_wavelength(image: CausticImage, scene: Scene, channel: int) -> tuple[CausticImage, Scene]:
    """What one wavelength shows of an image, and the scene of it."""
    kept = [channel]
    one = CausticImage(
        np.asarray(image.irradiance)[kept],
        None if image.noise_std is None else np.asarray(image.noise_std)[kept],
        None if image.mask is None else np.asarray(image.mask)[kept],
        None if image.own is None else np.asarray(image.own)[kept],
        image.size,
    )
    update = {"wavelengths_m": (scene.wavelengths_m[channel],), "radiosity_W_m2": (scene.radiosity_W_m2[channel],)}
    return one, scene.model_copy(update=update)


@dataclass(frozen=True, eq=False)
class OneWavelength:
    """What the clearest wavelength shows of an image.

    Attributes:
        channel: which it is.
        scene: of it alone.
        image: what was measured.
        camera: whose blur is in the misfit.
    """

    channel: int
    scene: Scene
    image: CausticImage
    camera: ChannelCamera

    @classmethod
    def clearest(cls, image: CausticImage, scene: Scene, camera: ChannelCamera) -> "OneWavelength":
        """Of an image, its scene and camera."""
        channel = clearest_wavelength(image, scene)
        seen, told = of_wavelength(image, scene, channel)
        return cls(channel, told, seen, camera.of_channel(channel))

    def fit(
        self,
        model: LineModel,
        pixels: int,
        *,
        photons_per_pixel: int = FINE_PHOTONS_PER_PIXEL,
        report: Callable[[float], None] | None = None,
        metric: ImageFit | None = None,
    ) -> ImageFit:
        """The misfit of lines at so many pixels; see :class:`~nets.reconstruct.fibres.image.image_fit.ImageFit`."""
        return ImageFit(
            self.scene,
            self.image,
            model,
            pixels,
            photons_per_pixel=photons_per_pixel,
            report=report,
            metric=metric,
            camera=self.camera,
        )

    def metric(self, model: LineModel, pixels: int) -> ImageFit:
        """The same of few photons, whose differences make the metric of a descent."""
        return self.fit(model, pixels, photons_per_pixel=METRIC_PHOTONS_PER_PIXEL)
