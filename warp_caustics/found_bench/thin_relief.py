"""What a bench that is not quite as told does to the heights: closed form, for a relief that is thin and smooth.

Light that meets the relief at x lands, to first order in its slopes, at

    y(x) = c - S + A x + grad F(h(x)),      F(h) = (n - 1) (D h + h^2 / (2 n)),

    D = d / n + g / n_o,      A = 1 + D / L,      c = - D L_xy / L  (of parallel light D tan a)

with the base d, the gap g, the indices n of the glass and n_o behind it, a lamp at the distance L beside the middle by
L_xy, and the window's middle S: Snell's law for small angles, by which a thin prism turns light by (n - 1) times its
slope, and what is higher by h is farther from the screen by as much glass. Heights h' that show on the told bench what
h shows on the true one send the same light to the same place:

    F(h'(x')) = (1 + m) F_true(h(x)),      x' = x + a + m x,      a = (dc - dS) / A,      m = dA / A,

and so, with dF = F_true - F,

    h' - h = (dF(h) + m F(h)) / F'(h) - (a + m x) . grad h .

A picture M too large enlarges F once more, (1 + M)^2; one that is turned by phi moves heights by phi e_z x x. Light
that comes in at a slope dt other than told meets what is higher by h earlier, and goes on less steeply in the glass: it
lands at - (1 - 1/n) h dt beside, which heights make up for by dF with laplace(dF) = - (1 - 1/n) div(h dt), no slope on
the rim.

So gap, thickness and index act as factors on the heights, shifts as slopes, and all is right where slopes are small:
tests/warp_caustics/found_bench compare with the simulator's own derivatives. Where light paths cross, heights that are
found from an image need not move so; nothing in closed form tells.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import scipy  # loads its parts when they are first used

from warp_caustics.height_field import cell_centres
from warp_caustics.scene import Scene
from warp_caustics.setup.optical import optical_parameters, optical_steps, optical_values, with_optical_values
from warp_caustics.setup.parameter import Parameter, chosen
from warp_caustics.types import FloatArray
from warp_caustics.way_of_light import way_of_light_m, ways_of_light_m

TURN, MAGNIFICATION = "turn_rad", "magnification"
PICTURE = (
    Parameter(TURN, "phi", "rad", -3.2, 3.2, 2e-3, "camera", "of the picture from x towards y"),
    Parameter(MAGNIFICATION, "M", "1", 0.1, 10.0, 3e-3, "camera", "of the picture against the plate's"),
)
"""Numbers of the picture that heights answer to; its shift is that of the screen."""

WITHOUT_RESPONSE = ("lamp_half_angle_rad", "lamp_radius_m")
"""A lamp's size blurs, and moves no light."""
STEP = 1.0
"""Of differences, in those of :func:`~warp_caustics.setup.optical.optical_steps`: closed forms have little rounding."""


@dataclass(frozen=True)
class ThinRelief:
    """The map above on one bench, mean over the wavelengths that shine.

    Attributes:
        linear: (n - 1) D [m].
        square: (n - 1) / (2 n).
        spread: A.
        offset_m: c - S, along x and y [m].
        shortened: 1 - 1/n.
        vergence: 1 / L [1/m].
        slant: of the light in the middle of the plate, along x and y.
    """

    linear: float
    square: float
    spread: float
    offset_m: tuple[float, float]
    shortened: float
    vergence: float
    slant: tuple[float, float]

    @classmethod
    def of(cls, scene: Scene) -> "ThinRelief":
        """Of a bench."""
        each = zip(scene.glass_indices, ways_of_light_m(scene), scene.radiosity_W_m2, strict=True)
        lit = [(n, way) for n, way, light in each if light > 0]
        way = way_of_light_m(scene)
        if scene.is_collimated:
            vergence, slant = 0.0, tuple(math.tan(angle) for angle in scene.light_tilt_rad)
        else:
            vergence = 1 / scene.light_distance_m
            slant = tuple(-place * vergence for place in scene.light_position_m[:2])
        return cls(
            linear=sum((n - 1) * own for n, own in lit) / len(lit),
            square=sum((n - 1) / (2 * n) for n, _ in lit) / len(lit),
            spread=1 + way * vergence,
            offset_m=(way * slant[0] - scene.screen_position_m[0], way * slant[1] - scene.screen_position_m[1]),
            shortened=sum(1 - 1 / n for n, _ in lit) / len(lit),
            vergence=vergence,
            slant=(slant[0], slant[1]),
        )

    def bent(self, heights: FloatArray) -> FloatArray:
        """F(h) [m^2], shape of heights [m]."""
        return heights * (self.linear + self.square * heights)

    def unbent(self, bent: FloatArray) -> FloatArray:
        """Heights of F [m], the inverse of :meth:`bent`; shape of those [m^2]."""
        root = np.sqrt(np.maximum(self.linear**2 + 4 * self.square * bent, 0.0))
        # The positive root of square h^2 + linear h = bent, without differences of what is nearly equal.
        return np.asarray(2 * bent / (self.linear + root))

    def bending(self, heights: FloatArray) -> FloatArray:
        """F'(h) [m], at least a tenth of that of the base."""
        return np.asarray(np.maximum(self.linear + 2 * self.square * heights, 0.1 * self.linear))


def parameters_of(scene: Scene) -> tuple[Parameter, ...]:
    """Numbers of a bench and its picture that heights answer to."""
    return (*(p for p in optical_parameters(scene) if p.name not in WITHOUT_RESPONSE), *PICTURE)


def relief_responses(scene: Scene, heights: FloatArray, names: Iterable[str] | None = None) -> dict[str, FloatArray]:
    """dh / d theta: by how much heights found on a told bench are off, per unit that the true one differs by.

    Args:
        scene: as it is told.
        heights: [m], shape [n, n], float64.
        names: of :func:`parameters_of`; None takes all.

    Returns:
        [m / unit] by name, shape [n, n] each.

    Raises:
        InputError: a name that no bench has.
    """
    known = {p.name: p for p in parameters_of(scene)}
    wanted = tuple(known) if names is None else chosen(names, tuple(known.values()))
    steps, values, at = optical_steps(scene), optical_values(scene, scene), ThinRelief.of(scene)
    x, y = (cell_centres(len(heights), size) for size in scene.plate_size_m)
    slope_y, slope_x = np.gradient(heights, *reversed(scene.sample_pitch_m))
    grown, bending = x[None, :] * slope_x + y[:, None] * slope_y, at.bending(heights)
    shape = at.bent(heights) / bending
    found: dict[str, FloatArray] = {}
    for name in wanted:
        if name == TURN:
            found[name] = y[:, None] * slope_x - x[None, :] * slope_y
            continue
        if name == MAGNIFICATION:
            found[name] = 2 * shape - grown
            continue
        step = STEP * steps[name]
        end = values[name] + step if values[name] + step <= known[name].high else values[name] - step
        other = ThinRelief.of(with_optical_values(scene, {name: end}))
        apart = end - values[name]
        moved = [(there - here) / apart / at.spread for there, here in zip(other.offset_m, at.offset_m, strict=True)]
        growth = (other.spread - at.spread) / apart / at.spread
        factor = (other.bent(heights) - at.bent(heights)) / apart / bending
        slant = [(there - here) / apart for there, here in zip(other.slant, at.slant, strict=True)]
        diverging = (other.vergence - at.vergence) / apart
        if diverging or any(slant):
            sideways = -at.shortened * heights
            beside = [sideways * (t + diverging * r) for t, r in zip(slant, (x, y[:, None]), strict=True)]
            factor = factor + _potential(beside[0], beside[1], scene.sample_pitch_m) / bending
        found[name] = factor + growth * (shape - grown) - moved[0] * slope_x - moved[1] * slope_y
    return found


def _potential(along_x: FloatArray, along_y: FloatArray, pitch_m: tuple[float, float]) -> FloatArray:
    """P whose gradient is nearest to a vector field, in least squares: laplace P = div, no slope on the rim, mean 0.

    By cosine transforms, which diagonalise the five-point Laplacian with mirrored borders.

    Args:
        along_x: shape [n, n].
        along_y: same.
        pitch_m: of samples along x and y [m].
    """
    n, (pitch_x, pitch_y) = len(along_x), pitch_m
    # Between samples, none through the rim.
    through_x, through_y = (along_x[:, 1:] + along_x[:, :-1]) / 2, (along_y[1:] + along_y[:-1]) / 2
    divergence = np.diff(through_x, axis=1, prepend=0, append=0) / pitch_x
    divergence = divergence + np.diff(through_y, axis=0, prepend=0, append=0) / pitch_y
    waves = 2 * np.cos(np.pi * np.arange(n) / n) - 2
    eigenvalues = waves[None, :] / pitch_x**2 + waves[:, None] / pitch_y**2
    eigenvalues[0, 0] = 1.0
    spectrum = scipy.fft.dctn(divergence, norm="ortho") / eigenvalues
    spectrum[0, 0] = 0.0
    return np.asarray(scipy.fft.idctn(spectrum, norm="ortho"))
