"""One wavelength of an image: it tells which lines there are, and nearly where, for a part of the time of all."""

import numpy as np

from warp_caustics.reconstruct.base import CausticImage
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
