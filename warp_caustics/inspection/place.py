"""Where a plate's picture lies as a whole, apart from what is the matter with single fibres.

Corners that are found a pixel aside move every fibre; so does a plate that lies a little turned, and a lamp that is
nearer than told makes the picture larger. Shift, turn and size of the whole are found as what most of the relief agrees
on, and so is a factor on all heights, which a gap, base or index other than told makes as well as the print:

    measured - nominal = -(s + omega J x + m x) . grad nominal + g nominal,

with each cell's deviation, by least squares that give up what is far off (Geman-McClure, from where a convex loss
leads). Linearised and repeated with the design moved along. Standard uncertainties are those of the sandwich (Huber
1967) over fibres, or over squares of a plate whose fibres are not known: what is printed errs fibre by fibre and not
cell by cell.

Limit: of two fibres of which one is displaced nothing tells which, but that the whole is rarely far off.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import scipy  # loads its parts when they are first used

from warp_caustics.height_field import cell_centres
from warp_caustics.inspection.nominal import Nominal
from warp_caustics.prints.fit_design import CORRELATED_CELLS, WAVINESS_M
from warp_caustics.prints.line import Line, line_patch
from warp_caustics.scene import Scene
from warp_caustics.types import BoolArray, FloatArray

SHIFT_M = 5e-5
"""Of the whole picture, loosely [m]: half a pixel of a plate of 50 mm."""
GAIN = 0.1
"""Of all heights, loosely."""
ROUNDS, ITERATIONS = 3, 12
"""Designs moved along; steps of re-weighted least squares about each."""
FAR_OFF = 2.0
"""Standard deviations at which a deviation is half given up."""
FIBRE_NUMBERS = 4.0
"""That the cells of one fibre tell: where both ends are, its height, its width."""
PRINTED_M = 2e-5
"""How far each fibre lies from its place, as it is printed [m]."""
SQUARES = 4
"""Along a side, over which the scatter is taken."""
FEWEST_CELLS = 50
"""Of relief that must be judged for a place to be looked for."""
RELIEF_M = 1e-5
"""From which height on a cell is one of the relief [m]."""
SIGNIFICANT = 2.0
"""Standard uncertainties from which on a number counts."""
STEP_M = 2e-5
"""Of differences by which a design's slope is taken [m]."""

Numbers = tuple[float, float, float, float, float]


@dataclass(frozen=True)
class Place:
    """Where the whole is, against the design.

    Attributes:
        shift_m: (x, y) of the middle [m].
        turn_rad: about it, from x towards y [rad].
        size: larger by [1].
        gain: all heights are higher by [1].
        sigma: standard uncertainties of these five, in this order.
    """

    shift_m: tuple[float, float] = (0.0, 0.0)
    turn_rad: float = 0.0
    size: float = 0.0
    gain: float = 0.0
    sigma: Numbers = (0.0, 0.0, 0.0, 0.0, 0.0)

    @property
    def numbers(self) -> FloatArray:
        """Shift, turn, size, gain, shape [5]."""
        return np.array([*self.shift_m, self.turn_rad, self.size, self.gain])

    @property
    def is_told(self) -> bool:
        """Whether nothing differs from the design."""
        return not self.numbers.any()

    def significant(self) -> "Place":
        """With 0 for what may as well be none."""
        kept = np.where(np.abs(self.numbers) > SIGNIFICANT * np.array(self.sigma), self.numbers, 0.0)
        return _place(kept, self.sigma)

    def moved(self, point_m: tuple[float, float]) -> tuple[float, float]:
        """Where a point of the design is [m]."""
        x, y = point_m
        return (
            x + self.shift_m[0] - self.turn_rad * y + self.size * x,
            y + self.shift_m[1] + self.turn_rad * x + self.size * y,
        )

    @property
    def line(self) -> str:
        """For people."""
        sx, sy, st, sm, sg = self.sigma
        return (
            f"moved by ({self.shift_m[0] * 1e6:.1f} +- {sx * 1e6:.1f}, {self.shift_m[1] * 1e6:.1f} +- {sy * 1e6:.1f}) "
            f"um, turned by {math.degrees(self.turn_rad):.4f} +- {math.degrees(st):.4f} degrees, larger by "
            f"{100 * self.size:.3f} +- {100 * sm:.3f} %; heights {100 * self.gain:+.1f} +- {100 * sg:.1f} %"
        )


def moved_design(nominal: Nominal, place: Place, scene: Scene) -> Nominal:
    """A design where its plate is; heights stay as designed.

    Args:
        nominal: the design.
        place: of the whole.
        scene: gives plate size and samples.
    """
    if replace(place, gain=0.0).is_told:
        return nominal
    if nominal.lines:
        lines = [moved_line(line, place) for line in nominal.lines]
        return replace(Nominal.of_lines(lines, scene, nominal.section), origin=nominal.origin)
    return replace(nominal, relief_m=_moved_map(nominal.relief_m, place, scene))


def moved_line(line: Line, place: Place) -> Line:
    """A line of the design where it is; its width stays."""
    return replace(line, start_m=place.moved(line.start_m), end_m=place.moved(line.end_m))


def _moved_map(relief_m: FloatArray, place: Place, scene: Scene) -> FloatArray:
    n = scene.height_samples
    x, y = (cell_centres(n, length) for length in scene.plate_size_m)
    pitch_x, pitch_y = scene.sample_pitch_m
    # Where what is now at a cell was before, to first order.
    (sx, sy), turn, size = place.shift_m, place.turn_rad, place.size
    back_x = x[None, :] - sx + turn * y[:, None] - size * x[None, :]
    back_y = y[:, None] - sy - turn * x[None, :] - size * y[:, None]
    at = np.stack([back_y / pitch_y, back_x / pitch_x]) + (n - 1) / 2
    moved: FloatArray = scipy.ndimage.map_coordinates(relief_m.astype(np.float64), at, order=3, mode="nearest")
    return moved


def found_place(
    heights_m: FloatArray,
    nominal: Nominal,
    scene: Scene,
    *,
    sigma_m: FloatArray | None = None,
    mask: BoolArray | None = None,
) -> Place:
    """Shift, turn and size of the whole, and the factor on all heights.

    Args:
        heights_m: measured relief, above the base [m], shape [n, n].
        nominal: the design.
        scene: gives plate size and samples.
        sigma_m: standard uncertainty [m], shape [n, n]; None if unknown.
        mask: True where the plate is judged, shape [n, n]; everywhere if None.

    Returns:
        The place; as told where there is hardly any relief.
    """
    judged = np.ones(heights_m.shape, bool) if mask is None else mask
    sigma: FloatArray = np.hypot(WAVINESS_M, np.zeros(heights_m.shape) if sigma_m is None else sigma_m)
    judged = judged & np.isfinite(sigma)
    if (judged & (nominal.relief_m > RELIEF_M)).sum() < FEWEST_CELLS:
        return Place()
    reach = max(scene.plate_size_m) / 2
    widths = np.array([SHIFT_M, SHIFT_M, SHIFT_M / reach, SHIFT_M / reach, GAIN])
    groups = _groups(nominal, scene)
    found: FloatArray = np.zeros(5)
    deviations: FloatArray = np.zeros(5)
    for number in range(ROUNDS):
        place = _place(found)
        basis = _responses(nominal, place, scene) * widths[:, None, None]
        at = moved_design(nominal, place, scene).relief_m
        rest = heights_m - (1 + place.gain) * at
        slope = np.hypot(basis[0], basis[1]) / SHIFT_M
        expected = np.hypot(sigma, PRINTED_M * slope)
        step, deviations = _robust(basis, rest, expected, judged, groups, -found / widths, is_first=not number)
        found = found + step * widths
    return _place(found, tuple((deviations * widths).tolist()))


def _place(numbers: FloatArray, sigma: tuple[float, ...] = (0.0,) * 5) -> Place:
    x, y, turn, size, gain = numbers.tolist()
    sx, sy, st, sm, sg = sigma
    return Place((x, y), turn, size, gain, (sx, sy, st, sm, sg))


def _responses(nominal: Nominal, place: Place, scene: Scene) -> FloatArray:
    """Derivatives of the design's relief by the five numbers, shape [5, n, n]."""
    reach = max(scene.plate_size_m) / 2
    steps = np.diag([STEP_M, STEP_M, STEP_M / reach, STEP_M / reach, 0.0])[:4]
    found = [
        (1 + place.gain)
        * (
            moved_design(nominal, _place(place.numbers + step), scene).relief_m
            - moved_design(nominal, _place(place.numbers - step), scene).relief_m
        )
        / (2 * step.sum())
        for step in steps
    ]
    return np.stack([*found, moved_design(nominal, place, scene).relief_m])


def _robust(
    basis: FloatArray,
    rest_m: FloatArray,
    sigma_m: FloatArray,
    judged: BoolArray,
    groups: npt.NDArray[np.int_],
    told: FloatArray,
    *,
    is_first: bool,
) -> tuple[FloatArray, FloatArray]:
    """Amplitudes of the basis and their standard uncertainties, shape [5] each [prior widths].

    Args:
        basis: shape [5, n, n] [m].
        rest_m: what they are to explain, shape [n, n] [m].
        sigma_m: its expected size, shape [n, n] [m].
        judged: cells that count, shape [n, n].
        groups: number of what each cell errs together with, shape [n, n].
        told: amplitudes that would be as told, shape [5].
        is_first: begin with a convex loss as well, which finds its way from anywhere.
    """
    group = groups[judged]
    columns = (basis / sigma_m)[:, judged]
    data = (rest_m / sigma_m)[judged]
    # A fibre tells four numbers, however many cells it covers.
    share = FIBRE_NUMBERS / np.bincount(group)[group]
    share = np.minimum(share, 1 / CORRELATED_CELLS)

    def descended(start: FloatArray, weigh: Callable[[FloatArray], FloatArray]) -> tuple[FloatArray, ...]:
        """Amplitudes, the weights of cells at the end, and the normal matrix."""
        found = start
        for _ in range(ITERATIONS):
            weight = share * weigh(data - found @ columns)
            normal = (columns * weight) @ columns.T + np.eye(5)
            found = np.linalg.solve(normal, (columns * weight) @ data + told)
        return found, weight, normal

    def cost(found: FloatArray) -> float:
        left = np.square((data - found @ columns) / FAR_OFF)
        return float((share * left / (1 + left)).sum() * FAR_OFF**2 + np.square(found - told).sum())

    # A few fibres may agree on a place that all that is known besides speaks against.
    starts = [np.zeros(5), descended(np.zeros(5), _charbonnier)[0]] if is_first else [np.zeros(5)]
    found, weight, normal = min((descended(start, _geman_mcclure) for start in starts), key=lambda each: cost(each[0]))
    left = (data - found @ columns) * weight
    scores = np.stack([np.bincount(group, left * column) for column in columns])
    # As many groups as numbers leave no scatter; one that holds nothing says nothing.
    count = int(np.count_nonzero(np.abs(scores).sum(axis=0)))
    inverse = np.linalg.inv(normal)
    scatter = inverse @ (scores @ scores.T * (count / max(count - 5, 1))) @ inverse
    deviations: FloatArray = np.sqrt(np.maximum(np.diag(scatter), np.diag(inverse)))
    return found, deviations


def _charbonnier(residual: FloatArray) -> FloatArray:
    weight: FloatArray = 1 / np.hypot(1.0, residual)
    return weight


def _geman_mcclure(residual: FloatArray) -> FloatArray:
    weight: FloatArray = np.square(1 + np.square(residual / FAR_OFF)) ** -1.0
    return weight


def _groups(nominal: Nominal, scene: Scene) -> npt.NDArray[np.int_]:
    """Number of the line that is highest at each cell, or of the square that it is in, shape [n, n]."""
    n = scene.height_samples
    if nominal.lines:
        highest, number = np.zeros((n, n)), np.zeros((n, n), int)
        for k, line in enumerate(nominal.lines, 1):
            rows, columns, patch = line_patch(line, n, scene.plate_size_m, section=nominal.section)
            is_higher = patch > highest[rows, columns]
            highest[rows, columns][is_higher] = patch[is_higher]
            number[rows, columns][is_higher] = k
        return number
    part = np.arange(n) * SQUARES // n
    return part[:, None] * SQUARES + part[None, :]
