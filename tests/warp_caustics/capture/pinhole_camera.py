"""A camera that looks at the screen at an angle: perspective, lens, blur, vignetting, offset, hot pixels and noise.

It follows rays from its pixels to the screen; the software goes the other way and shares no code with it.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import ndimage

from warp_caustics.io import ImageFile
from warp_caustics.prints.line import Line, line_relief
from warp_caustics.scene import Scene

LINES = [
    Line((-0.021, -0.017), (0.019, -0.006), 1.6e-3, 3.5e-4),
    Line((-0.019, 0.014), (0.021, 0.003), 2.2e-3, 4e-4),
    Line((-0.006, -0.022), (-0.011, 0.021), 1.2e-3, 2.5e-4),
    Line((0.013, -0.020), (0.006, 0.019), 2.8e-3, 5e-4),
    Line((-0.022, -0.002), (0.020, 0.018), 1.0e-3, 2e-4),
]


def caustic(pixels: int, finer: int = 4, samples: int = 128) -> tuple[np.ndarray, np.ndarray]:
    """Irradiance of a plate with fibres at ``pixels`` and at ``finer`` times as many per side, shape [3, ...]."""
    import torch

    from warp_caustics import CausticSimulator

    scene = Scene(image_pixels=pixels * finer, height_samples=samples)
    relief = torch.tensor(line_relief(LINES, samples, scene.plate_size_m), dtype=torch.float32)
    fine = CausticSimulator(scene, device="cpu")(relief).numpy().astype(np.float64)
    return fine.reshape(3, pixels, finer, pixels, finer).mean(axis=(2, 4)), fine


def turn(axis: int, angle_deg: float) -> np.ndarray:
    c, s = np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))
    matrix = np.eye(3)
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    matrix[[i, i, j, j], [i, j, i, j]] = c, -s, s, c
    return matrix


@dataclass
class PinholeCamera:
    """Linear sensor behind a lens, above the middle of the window.

    Coordinates of the camera: x along columns, y along rows, z into the scene. Untilted, the screen's x and y are
    the camera's.
    """

    width: int = 720
    height: int = 640
    fill: float = 0.75
    distance_m: float = 0.12
    tilt_deg: float = 5.0
    pan_deg: float = 3.0
    roll_deg: float = 2.0
    lens: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)  # k1 k2 p1 p2 k3
    blur_px: float = 0.6
    vignetting: float = 0.35
    gain: tuple[float, ...] = (9000.0, 12000.0, 7000.0)
    offset: float = 300.0
    electrons_per_count: float = 2.5
    read_noise: float = 4.0
    hot: int = 150
    surround: float = 0.004
    bits: int = 16
    finer: int = 3
    noisy: bool = True
    seed: int = 0

    def __post_init__(self) -> None:
        self.f = self.fill * self.height * self.distance_m / 0.05
        self.c = np.array([self.width / 2 - 3.3, self.height / 2 + 2.2])
        self.rotation = turn(2, self.roll_deg) @ turn(1, self.pan_deg) @ turn(0, self.tilt_deg)
        self.at = np.array([0.0, 0.0, self.distance_m])
        random = np.random.default_rng((self.seed, 99))
        size = self.height * self.width
        self.hot_at = np.sort(random.choice(size, self.hot, replace=False))
        # Half of them shine in the dark as well; the others gain counts with the light only, or are dead.
        self.hot_dark = random.uniform(800, 9000, (3, self.hot)) * (np.arange(self.hot) % 2 == 0)
        self.hot_gain = np.where(np.arange(self.hot) % 4 == 1, 6.0, np.where(np.arange(self.hot) % 4 == 3, 0.02, 1.0))

    # ------------------------------------------------------------------ geometry

    def project(self, position_m: np.ndarray) -> np.ndarray:
        """Pixels (x, y) of places on the screen [m]."""
        position = np.asarray(position_m, float)
        place = np.concatenate([position, np.zeros((*position.shape[:-1], 1))], axis=-1)
        seen = place @ self.rotation.T + self.at
        return self._lens(seen[..., :2] / seen[..., 2:]) * self.f + self.c

    def _lens(self, normal: np.ndarray) -> np.ndarray:
        k1, k2, p1, p2, k3 = self.lens
        x, y = normal[..., 0], normal[..., 1]
        r = x**2 + y**2
        scale = 1 + k1 * r + k2 * r**2 + k3 * r**3
        return np.stack(
            [x * scale + 2 * p1 * x * y + p2 * (r + 2 * x**2), y * scale + p1 * (r + 2 * y**2) + 2 * p2 * x * y],
            axis=-1,
        )

    def screen_position(self, pixel: np.ndarray) -> np.ndarray:
        """Places on the screen [m] that pixels (x, y) see."""
        target = (pixel - self.c) / self.f
        normal = target.copy()
        for _ in range(30 if any(self.lens) else 0):
            normal += target - self._lens(normal)
        ray = np.concatenate([normal, np.ones((*normal.shape[:-1], 1))], axis=-1) @ self.rotation
        start = -self.at @ self.rotation
        return (start - start[2] * ray / ray[..., 2:])[..., :2]

    def perspective(self) -> float:
        """Longest over shortest of two opposite sides of the window, less 1."""
        corners = self.project(np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * 0.025)
        side = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
        return float(max(side[0] / side[2], side[2] / side[0], side[1] / side[3], side[3] / side[1]) - 1)

    def window_error_px(self, registration, pixels: int) -> float:
        """Largest error of a registration over the window [pixels of the scene]."""
        line = np.linspace(-0.025, 0.025, 21)
        grid = np.stack(np.meshgrid(line, line), axis=-1)
        back = self.screen_position(registration.to_photo(grid))
        return float(np.linalg.norm(back - grid, axis=-1).max() / 0.05 * pixels)

    def intrinsics(self) -> dict:
        names = ("k1", "k2", "p1", "p2", "k3")
        return {"f_px": (self.f, self.f), "c_px": tuple(self.c), **dict(zip(names, self.lens, strict=True))}

    # ------------------------------------------------------------------ light

    @cached_property
    def places(self) -> np.ndarray:
        """Places [m] that ``finer`` x ``finer`` points in each pixel see, shape [rows, columns, 2]."""
        n = self.finer
        y, x = (np.arange(size * n) / n + 0.5 / n - 0.5 for size in (self.height, self.width))
        return self.screen_position(np.stack(np.meshgrid(x, y), axis=-1))

    def expected(self, light: np.ndarray | float, marks: list | None = None, mark_m: float = 6e-4) -> np.ndarray:
        """Light on each pixel without response and noise, shape [3, height, width].

        Args:
            light: irradiance in the window, shape [3, k, k], or one number.
            marks: places [m] of dark dots on the screen.
            mark_m: their radius.
        """
        n, place = self.finer, self.places
        inside = (np.abs(place) < 0.025).all(axis=-1)
        shown = np.full((3, *inside.shape), self.surround)
        if np.ndim(light) == 0:
            shown[:, inside] = light
        else:
            index = (place / 0.05 + 0.5) * light.shape[-1] - 0.5
            for channel in range(3):
                # Mean of the fine pixels around: linear, they are finer than the camera's.
                value = ndimage.map_coordinates(light[channel], [index[..., 1], index[..., 0]], order=1, mode="nearest")
                shown[channel][inside] = value[inside]
        for mark in marks or ():
            shown[:, ((place - mark) ** 2).sum(axis=-1) < mark_m**2] *= 0.15
        blurred = ndimage.gaussian_filter(shown, (0, self.blur_px * n, self.blur_px * n))
        return blurred.reshape(3, self.height, n, self.width, n).mean(axis=(2, 4))

    def response(self) -> np.ndarray:
        row, column = (np.mgrid[: self.height, : self.width] + 0.5) / self.height - 0.5
        response = 1 / (1 + self.vignetting * ((row - 0.05) ** 2 + (column - 0.1) ** 2)) ** 2
        response.ravel()[self.hot_at] *= self.hot_gain
        return response

    def record(self, expected: np.ndarray | float, exposure: float = 1.0, seed: int = 0) -> ImageFile:
        """A frame of what :meth:`expected` gave, or of darkness (0)."""
        random = np.random.default_rng((self.seed, seed, round(1e6 * exposure)))
        signal = np.array(self.gain)[:, None, None] * exposure * self.response() * expected
        electrons = signal * self.electrons_per_count
        if self.noisy:
            electrons = random.poisson(electrons)
        counts = electrons / self.electrons_per_count + self.offset
        counts.reshape(3, -1)[:, self.hot_at] += self.hot_dark
        if self.noisy:
            counts += random.normal(0, self.read_noise, counts.shape)
        full = 2.0**self.bits - 1
        counts = np.clip(np.rint(counts), 0, full)
        return ImageFile(counts.astype(np.float32), full_scale=full, bit_depth=self.bits, format="tiff")


TILTED = {"tilt_deg": 5.0, "pan_deg": 0.0, "roll_deg": 3.0}
"""5 deg."""
PERSPECTIVE = {"tilt_deg": 11.4, "pan_deg": 2.0, "roll_deg": -4.0, "distance_m": 0.11}
"""One side of the window is 10 % longer than the other."""
BARREL = (-0.12, 0.03, 1.5e-3, -1e-3, 0.0)
