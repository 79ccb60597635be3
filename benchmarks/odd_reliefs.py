"""What printers, bases and benches do that no model of this project knows.

Reliefs take true heights [m], shape [n, n], and random numbers; benches take the scene that is told.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.ndimage

from benchmarks.odd_light import places, warped
from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray

Print = Callable[[FloatArray, np.random.Generator], FloatArray]


def beside(of: Callable[[FloatArray, FloatArray], FloatArray]) -> Print:
    """Added to what is printed: a function of x and y, from -1 to 1."""
    return lambda heights, rng: heights + of(*places(len(heights)))


def times(of: Callable[[FloatArray, FloatArray], FloatArray]) -> Print:
    """A factor on what is printed: a function of x and y, from -1 to 1."""
    return lambda heights, rng: heights * of(*places(len(heights)))


def steps(heights: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Layers of 50 um, a little molten."""
    return np.asarray(scipy.ndimage.gaussian_filter(np.round(heights / 5e-5) * 5e-5, 0.7))


def drips(heights: FloatArray, rng: np.random.Generator) -> FloatArray:
    """A dozen, 20 to 80 um high."""
    (x, y), heights = places(len(heights)), heights.copy()
    for _ in range(12):
        at_x, at_y = rng.uniform(-0.9, 0.9, 2)
        size = rng.uniform(0.02, 0.06)
        heights += rng.uniform(20, 80) * 1e-6 * np.exp(-((x - at_x) ** 2 + (y - at_y) ** 2) / 2 / size**2)
    return heights


def broken(heights: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Lines with four gaps."""
    (x, y), heights = places(len(heights)), heights.copy()
    rows, columns = np.nonzero(heights > 0.5 * heights.max())
    for k in rng.integers(0, len(rows), 4):
        squared = ((x - x[0, columns[k]]) ** 2 + (y - y[rows[k], 0]) ** 2) / 2 / 0.03**2
        heights *= 1 - np.exp(-(squared**3))
    return heights


def hills(samples: float, height_m: float) -> Print:
    """No lines at all, but random hills so wide and high."""

    def change(heights: FloatArray, rng: np.random.Generator) -> FloatArray:
        smooth = scipy.ndimage.gaussian_filter(rng.standard_normal(heights.shape), samples)
        smooth -= smooth.min()
        return np.asarray(smooth / smooth.max() * height_m)

    return change


def lens(heights: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Of 35 mm, 0.4 mm high."""
    x, y = places(len(heights))
    return np.asarray(400e-6 * np.maximum(1 - (x * x + y * y) / 0.5, 0))


def rough(heights: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Lines whose surface is rough by a micrometre."""
    grain = scipy.ndimage.gaussian_filter(rng.standard_normal(heights.shape), 1.5)
    return np.asarray(heights + 15e-6 * grain * (heights > 5e-6))


def bumpy(heights: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Lines higher and lower by up to 10 %, at random."""
    grain = scipy.ndimage.gaussian_filter(rng.standard_normal(heights.shape), 6)
    return np.asarray(heights * (1 + 0.1 * np.clip(20 * grain, -2, 2) / 2))


def leaning(heights: FloatArray, rng: np.random.Generator) -> FloatArray:
    """What is high is displaced along x, by twice its height."""
    leaned: FloatArray = warped(heights[None], 2e3 * heights, 0.0)[0]
    return leaned


RELIEFS: dict[str, tuple[str, Print]] = {
    "wedge": ("base a wedge, 100 um", beside(lambda x, y: 50e-6 * (x + 1))),
    "wave5": (
        "base wavy by 5 um, over 6 and 8 mm",
        beside(lambda x, y: 5e-6 * np.sin(8 * np.pi * x) * np.sin(6 * np.pi * y + 1)),
    ),
    "taper": ("lines higher by 25 % on one side", times(lambda x, y: 1 + 0.25 * x)),
    "wobble": ("lines higher and lower by 15 %", times(lambda x, y: 1 + 0.15 * np.sin(3 * np.pi * (x + y)))),
    "staircase": ("layers of 50 um", steps),
    "lumps": ("a dozen drips beside the lines", drips),
    "broken": ("lines with gaps", broken),
    "freeform": ("no lines: hills of 0.2 mm", hills(8, 200e-6)),
    "freefold": ("hills of 0.6 mm, narrower", hills(5, 600e-6)),
    "lens": ("no lines: a lens", lens),
    "bare": ("nothing printed", lambda heights, rng: 0 * heights),
    "groove": (
        "a groove, 60 um deep",
        beside(lambda x, y: -60e-6 * np.exp(-((y - 0.4 * x - 0.1) ** 2) / 2 / 0.02**2)),
    ),
    "scratch": ("a scratch, 10 um", beside(lambda x, y: -10e-6 * np.exp(-((y + 0.7 * x - 0.1) ** 2) / 2 / 0.012**2))),
    "rough": ("lines rough by 1 um", rough),
    "ripple": ("lines rippled by 4 %", times(lambda x, y: 1 + 0.04 * np.sin(40 * np.pi * x))),
    "bumpy": ("lines bumpy by 10 %", bumpy),
    "spread": ("molten wide", lambda heights, rng: np.asarray(scipy.ndimage.gaussian_filter(heights, 1.5))),
    "skewed": ("lines that lean", leaning),
    "plateau": ("lines pressed flat", lambda heights, rng: np.minimum(heights, 0.7 * heights.max())),
    "big_bow": ("base bowed by 60 um", beside(lambda x, y: 60e-6 * (x * x + y * y))),
    "astig_bow": ("base a saddle, 30 um", beside(lambda x, y: 30e-6 * (x * x - 0.5 * y * y) + 15e-6)),
    "step_base": ("base with a step of 20 um", beside(lambda x, y: 20e-6 / (1 + np.exp(-x / 0.02)))),
}
"""By name: in words, and what is printed."""


def farther(scene: Scene) -> dict[str, Any]:
    """A gap 1 mm wider."""
    x, y, z = scene.screen_position_m
    return {"screen_position_m": (x, y, z - 1e-3)}


BENCHES: dict[str, tuple[str, Callable[[Scene], dict[str, Any]]]] = {
    "gap_1mm": ("gap 1 mm wider", farther),
    "base_27": ("base 0.3 mm thinner", lambda scene: {"base_thickness_m": 2.7e-3}),
    "base_4mm": ("base 1 mm thicker", lambda scene: {"base_thickness_m": 4e-3}),
    "pmma": ("index 1.49 instead of 1.458", lambda scene: {"glass": 1.4900}),
    "bk7": ("index 1.517", lambda scene: {"glass": 1.5168}),
    "tilt1": ("light tilted by a degree", lambda scene: {"light_tilt_rad": (math.radians(1.0), math.radians(0.3))}),
    "disc1": ("lamp of half angle 1 degree", lambda scene: {"lamp_half_angle_rad": math.radians(1.0)}),
    "disc2": ("2 degrees", lambda scene: {"lamp_half_angle_rad": math.radians(2.0)}),
}
"""By name: in words, and fields of the scene as it is."""

COLOURS: dict[str, tuple[str, tuple[FloatArray, ...]]] = {
    "leds": ("lamps of other wavelengths, by 10 to 20 nm", (np.array([20e-9, -15e-9, 10e-9]),)),
    "wide": ("lamps 36 nm wide", tuple(np.full(3, k * 12e-9) for k in (-1.5, -0.5, 0.5, 1.5))),
}
"""By name: in words, and what is added to the wavelengths [m], of lights that are as bright."""
