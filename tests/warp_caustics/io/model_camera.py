"""A model camera that records a known irradiance, with the noise of a real one."""

from dataclasses import dataclass

import numpy as np

from warp_caustics.io import ImageFile
from warp_caustics.scene import Scene

M = 160
SCENE = Scene(image_pixels=M)


def smooth_light() -> np.ndarray:
    row, column = np.mgrid[:M, :M] / M
    return 1 + 0.2 * np.sin(4 * row + 1) * np.cos(5 * column)


def caustic_light() -> np.ndarray:
    """Folds: 1/sqrt(distance) on one side of curved lines, shadow on the other, lit plain elsewhere."""
    row, column = np.mgrid[:M, :M] / M
    light = np.ones((M, M))
    for offset, slope, bend in ((0.2, 0.3, 0.2), (0.5, -0.4, 0.5), (0.8, 0.1, -0.3)):
        distance = (row - offset - slope * (column - 0.5) - bend * (column - 0.5) ** 2) * M
        light += np.where((distance > 0) & (distance < 12), 2 / np.sqrt(np.maximum(distance, 0.5)) - 0.55, 0)
        light -= np.where((distance <= 0) & (distance > -6), 0.8, 0)
    return np.maximum(light, 0.02)


LIGHT = np.stack([caustic_light(), np.roll(caustic_light(), 9, axis=0), caustic_light().T])
LIGHT /= LIGHT.mean(axis=(1, 2), keepdims=True)


@dataclass
class Camera:
    """Linear sensor: counts = offset + gain L v(x, y) + noise; shot noise follows from the electrons per count."""

    gain: tuple[float, ...] = (4000.0, 6000.0, 3000.0)
    offset: float = 200.0
    electrons_per_count: float = 2.5
    read_noise: float = 4.0
    vignetting: float = 0.35
    seed: int = 0

    def response(self) -> np.ndarray:
        row, column = (np.mgrid[:M, :M] + 0.5) / M - 0.5
        return 1 / (1 + self.vignetting * ((row - 0.05) ** 2 + column**2)) ** 2

    def record(self, light: np.ndarray | float, exposure: float = 1.0) -> ImageFile:
        random = np.random.default_rng((self.seed, int(1e6 * exposure), int(np.sum(light))))
        gain = np.array(self.gain)[:, None, None] * exposure
        electrons = random.poisson(gain * light * self.response() * self.electrons_per_count)
        counts = electrons / self.electrons_per_count + self.offset + random.normal(0, self.read_noise, electrons.shape)
        return as_file(np.clip(np.rint(counts), 0, 65535))

    def noise_std(self) -> np.ndarray:
        """Standard deviation [W/m^2] at irradiance 1, averaged over the vignetting (root mean square), shape [3]."""
        signal = np.array(self.gain)[:, None, None] * self.response()
        variance = (signal / self.electrons_per_count + self.read_noise**2 + 1 / 12) / signal**2
        return np.sqrt(variance.mean(axis=(1, 2)))

    def frames(self, light: np.ndarray = LIGHT) -> tuple[ImageFile, ImageFile, ImageFile]:
        return self.record(light), self.record(np.zeros((1, M, M))), self.record(np.ones((1, M, M)))


def as_file(values: np.ndarray, **fields: object) -> ImageFile:
    defaults = {"full_scale": 65535.0, "bit_depth": 16, "format": "tiff"}
    return ImageFile(values=np.asarray(values, np.float32), **(defaults | fields))


def as_floats(values: np.ndarray, **fields: object) -> ImageFile:
    return as_file(values, **({"full_scale": None, "bit_depth": 32} | fields))
