"""The light path of the model, forwards, and backwards from a landing point to the slope that sends light there.

The same geometry as ``kernels/general.py`` and ``oracle.py``: refraction at the
relief, straight to the bottom face z = 0, refraction there, straight to the
screen. At a plane interface n sin(theta) and the azimuth are kept, so a path below
the relief is described by the two components of k = n (x, y part of its unit
direction), and it travels sideways by k / sqrt(n^2 - |k|^2) per unit of depth.
Everything is float64 NumPy on whole grids; unlike the oracle there is no relief
to evaluate, heights and slopes are given. Forwards:

    x' = x + k (d + h) / sqrt(n^2 - |k|^2) + k g / sqrt(n_e^2 - |k|^2),

d + h the glass, g the gap below it; backwards |k| is the root of that by Newton's method, and the normal is along
i - n t, i and t the unit directions before and behind the relief (Snell's law as a vector).
"""

from dataclasses import dataclass

import numpy as np

from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray

NEWTON_STEPS = 30
"""Enough from the bound below; even next to total reflection an iterate at least halves its distance."""

MAX_SLOPE = 4.0
"""Steeper relief is not asked for: printed lines of Tab. 3 reach 3.5."""

LEAST_DEPTH = 0.1
"""Glass is taken to be at least this share of the plate thick."""


@dataclass(frozen=True)
class LightPath:
    """What a path crosses.

    Attributes:
        glass: refractive index of the plate.
        outside: refractive index below it.
        thickness_m: d, from the bottom face to the bare plate [m].
        gap_m: from the bottom face to the screen [m].
        light_m: (x, y, z) of the point source [m]; None for collimated light.
        direction: unit vector along which collimated light travels.
    """

    glass: float
    outside: float
    thickness_m: float
    gap_m: float
    light_m: tuple[float, float, float] | None = None
    direction: tuple[float, float, float] = (0.0, 0.0, -1.0)

    @classmethod
    def of_scene(cls, scene: Scene, *, single_refraction: bool = False) -> "LightPath":
        """The scene's path at the mean index of the wavelengths that shine.

        ``single_refraction`` ignores the bottom face: glass down to the screen.
        """
        light = np.asarray(scene.radiosity_W_m2) > 0
        glass = float(np.mean(np.asarray(scene.glass_indices)[light]))
        outside = glass if single_refraction else float(np.mean(np.asarray(scene.exit_indices)[light]))
        source = None if scene.is_collimated else scene.light_position_m
        return cls(glass, outside, scene.base_thickness_m, -scene.screen_position_m[2], source, scene.light_direction)

    def incident(self, points: FloatArray, heights: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Unit direction of the light at points (x, y) [m], shape [2, ...], and heights [m]: (x, y) part and z part."""
        if self.light_m is None:
            x, y, z = self.direction
            return np.stack([np.full(points.shape[1:], x), np.full(points.shape[1:], y)]), np.full(points.shape[1:], z)
        sideways = np.stack([points[axis] - self.light_m[axis] for axis in (0, 1)])
        down = self.thickness_m + heights - self.light_m[2]
        length = np.sqrt((sideways**2).sum(0) + down**2)
        return sideways / length, down / length

    def landing(self, points: FloatArray, heights: FloatArray, slopes: FloatArray) -> FloatArray:
        """Where light through points of the relief meets the screen.

        Args:
            points: (x, y) [m], shape [2, ...].
            heights: relief there [m], shape [...].
            slopes: (dh/dx, dh/dy) there, shape [2, ...].

        Returns:
            (x, y) [m], shape [2, ...]; NaN where light is totally reflected.
        """
        sideways, down = self.incident(points, heights)
        norm = np.sqrt(1 + (slopes**2).sum(0))
        cosine = (-down + (sideways * slopes).sum(0)) / norm
        with np.errstate(invalid="ignore"):
            # Snell in vector form: n t = i + (sqrt(n^2 - 1 + cos^2) - cos) (-N), N the upward normal.
            bend = np.sqrt(self.glass**2 - 1 + cosine**2) - cosine
            k = sideways + bend * slopes / norm
            squared = (k**2).sum(0)
            landing: FloatArray = points + k * (
                (self.thickness_m + heights) / np.sqrt(self.glass**2 - squared)
                + self.gap_m / np.sqrt(self.outside**2 - squared)
            )
        return landing

    def slopes_towards(self, points: FloatArray, heights: FloatArray, targets: FloatArray) -> tuple[FloatArray, float]:
        """Slopes that send light from points of the relief to targets on the screen.

        Args:
            points: (x, y) [m], shape [2, ...].
            heights: relief there [m], shape [...].
            targets: (x, y) on the screen [m], shape [2, ...].

        Returns:
            (dh/dx, dh/dy), shape [2, ...], no steeper than :data:`MAX_SLOPE`, and the share of points where
            that limit, or that of refraction, was met.
        """
        offset = targets - points
        distance = np.sqrt((offset**2).sum(0))
        # A surface on its way to better heights may dip through the bottom face.
        depth = np.maximum(self.thickness_m + heights, LEAST_DEPTH * self.thickness_m)
        k = self._sideways(distance, depth)
        sideways, down = self.incident(points, heights)
        # The normal is along i - n t.
        direction = offset / np.maximum(distance, 1e-300)
        upward = np.sqrt(self.glass**2 - k**2) + down
        slopes = (k * direction - sideways) / np.maximum(upward, 1e-9)
        steepness = np.sqrt((slopes**2).sum(0))
        limited = slopes * np.minimum(1.0, MAX_SLOPE / np.maximum(steepness, 1e-300))
        return limited, float((steepness > MAX_SLOPE).mean())

    def _sideways(self, distance: FloatArray, depth: FloatArray) -> FloatArray:
        """|k| of the path that travels a distance sideways [m] over a depth of glass [m] and the gap."""
        # Each medium alone would do it at a larger k: a start to the right of the root of a convex
        # function, from where Newton's steps approach it from one side only.
        k = self.glass * distance / np.hypot(distance, depth)
        if self.gap_m > 0:
            k = np.minimum(k, self.outside * distance / np.hypot(distance, self.gap_m))
        k = np.minimum(k, min(self.glass, self.outside) * (1 - 1e-12))
        for _ in range(NEWTON_STEPS):
            inside, below = self.glass**2 - k**2, self.outside**2 - k**2
            value = k * (depth / np.sqrt(inside) + self.gap_m / np.sqrt(below)) - distance
            slope = depth * self.glass**2 / inside**1.5 + self.gap_m * self.outside**2 / below**1.5
            step = value / slope
            k = np.maximum(k - step, 0.0)
            if np.abs(step).max() < 1e-15:
                break
        return k
