"""Plates whose relief is known but for a few numbers: none, a lens, a wedge, a measured map, a printed design.

    h(x, y) = h_0(x, y) + sum_k q_k m_k(x, y),     q_k of standard deviation w_k (its tolerance)

where modes m_k are a higher relief, wider lines, and a plate that lies elsewhere or turned. Heights are above the
base, which has
its own number in the set-up. A lens is the segment of a sphere (Born and Wolf, Principles of Optics, section 4.4: the
sag
is R - sqrt(R^2 - r^2)).
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import torch

from warp_caustics.errors import InputError, known_names
from warp_caustics.height_field import MARGIN, basis_matrix, cell_centres, prefilter_matrix
from warp_caustics.scene import Scene
from warp_caustics.setup.parameter import Parameter

Relief = Callable[[int, tuple[float, float]], np.ndarray]
"""Heights [m], shape [n, n], of n and the plate's size [m]."""

FLAT, LENS, WEDGE, MAP, DESIGN = "flat", "lens", "wedge", "map", "design"

TOLERANCES: dict[str, dict[str, float]] = {
    FLAT: {},
    LENS: {"height_scale": 0.01, "shift_x_m": 2e-4, "shift_y_m": 2e-4},
    WEDGE: {"height_scale": 0.01, "turn_rad": 5e-3},
    MAP: {"height_scale": 5e-3, "shift_x_m": 1e-4, "shift_y_m": 1e-4, "turn_rad": 2e-3},
    DESIGN: {"height_scale": 0.05, "width_scale": 0.03, "shift_x_m": 2e-4, "shift_y_m": 2e-4, "turn_rad": 2e-3},
}
"""What is usually not known of each kind, standard deviations; 0 leaves a number out."""
_UNITS = {"height_scale": "1", "width_scale": "1", "shift_x_m": "m", "shift_y_m": "m", "turn_rad": "rad"}
_MEANINGS = {
    "height_scale": "all heights, against 1", "width_scale": "all widths, against 1", "shift_x_m": "plate towards x",
    "shift_y_m": "plate towards y", "turn_rad": "plate from x towards y",
}  # fmt: skip
WIDER = 1e-2
"""Relative change of widths whose difference gives their mode."""


@dataclass(frozen=True, eq=False)
class KnownPlate:
    """A plate.

    Attributes:
        kind: flat, lens, wedge, map or design.
        name: for people.
        relief: heights [m], shape [n, n], of n and the plate's size.
        tolerances: standard deviation of each number that is not known exactly, by name.
        wider: heights when all widths are so many times as large; None where there are no widths.
    """

    kind: str
    name: str
    relief: Relief
    tolerances: Mapping[str, float]
    wider: Callable[[float, int, tuple[float, float]], np.ndarray] | None = None

    def with_tolerances(self, given: Mapping[str, float]) -> "KnownPlate":
        """The same with other tolerances.

        Raises:
            InputError: an unknown name, or one below 0.
        """
        for name, width in given.items():
            if name not in _UNITS or (name == "width_scale" and self.wider is None):
                known = [word for word in _UNITS if word != "width_scale" or self.wider is not None]
                raise InputError(f"tolerance {name!r} is none of {self.kind} {self.name}; {known_names(name, known)}")
            if not 0 <= width < math.inf:
                raise InputError(f"tolerance {name} {width:g} is below 0; give a standard deviation, 0 for none")
        return KnownPlate(self.kind, self.name, self.relief, {**self.tolerances, **given}, self.wider)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Numbers that are not known exactly; all are 0 where the plate is as it is told."""
        return tuple(
            Parameter(name, name, _UNITS[name], -10 * width, 10 * width, width, "plate", _MEANINGS[name])
            for name, width in self.tolerances.items()
            if width > 0
        )

    def surface(self, scene: Scene) -> tuple[torch.Tensor, torch.Tensor]:
        """h_0 [m], shape [n, n], and the modes [m per unit], shape [K, n, n], float64."""
        n, size = scene.height_samples, scene.plate_size_m
        heights = np.asarray(self.relief(n, size), dtype=np.float64)
        if heights.shape != (n, n):
            raise InputError(f"{self.name} has shape {list(heights.shape)}, the scene [{n}, {n}]; resample it")
        modes = [self._mode(p.name, heights, n, size) for p in self.parameters]
        stacked = np.stack(modes) if modes else np.zeros((0, n, n))
        return torch.from_numpy(heights.copy()), torch.from_numpy(stacked)

    def _mode(self, name: str, heights: np.ndarray, n: int, size: tuple[float, float]) -> np.ndarray:
        if name == "height_scale":
            return heights
        if name == "width_scale":
            assert self.wider is not None
            return np.asarray((self.wider(1 + WIDER, n, size) - self.wider(1 - WIDER, n, size)) / (2 * WIDER))
        along_x, along_y = _slopes(heights, size)
        if name == "shift_x_m":
            return -along_x
        if name == "shift_y_m":
            return -along_y
        x, y = (cell_centres(n, length) for length in size)
        return np.asarray(along_x * y[:, None] - along_y * x[None, :])


def _slopes(heights: np.ndarray, size: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """dh/dx and dh/dy at the samples [1], of the spline that light sees."""
    n = len(heights)
    at = np.arange(n, dtype=np.float64)
    to_coefficients = prefilter_matrix(n)
    slope = basis_matrix(n, at, 1) @ to_coefficients
    value = basis_matrix(n, at, 0) @ to_coefficients
    assert slope.shape == (n, n) and to_coefficients.shape == (n + 2 * MARGIN, n)
    along_x = value @ heights @ slope.T * (n / size[0])
    along_y = slope @ heights @ value.T * (n / size[1])
    return along_x, along_y


def flat_plate() -> KnownPlate:
    """No relief."""
    return KnownPlate(FLAT, "flat", lambda n, size: np.zeros((n, n)), TOLERANCES[FLAT])


def lens(
    radius_m: float, diameter_m: float, centre_m: tuple[float, float] = (0.0, 0.0), name: str = "lens"
) -> KnownPlate:
    """A plano-convex lens on the plate; beyond its rim the plate is flat.

    Args:
        radius_m: R of the curved face [m].
        diameter_m: of the rim [m].
        centre_m: (x, y) [m].
        name: for people.

    Raises:
        InputError: a rim wider than the sphere.
    """
    if not 0 < diameter_m < 2 * radius_m:
        raise InputError(
            f"{name}: a face of radius {radius_m * 1e3:g} mm has no rim of {diameter_m * 1e3:g} mm; it is below "
            f"{2e3 * radius_m:g} mm"
        )
    lowest = math.sqrt(radius_m**2 - diameter_m**2 / 4)

    def relief(n: int, size: tuple[float, float]) -> np.ndarray:
        x, y = (cell_centres(n, length) - at for length, at in zip(size, centre_m, strict=True))
        square = radius_m**2 - x[None, :] ** 2 - y[:, None] ** 2
        return np.asarray(np.maximum(np.sqrt(np.maximum(square, 0.0)) - lowest, 0.0))

    return KnownPlate(LENS, name, relief, TOLERANCES[LENS])


def wedge(angle_rad: float, towards_rad: float = 0.0, name: str = "wedge") -> KnownPlate:
    """A plate that grows thicker by tan(angle) towards a direction.

    Args:
        angle_rad: between its faces [rad].
        towards_rad: direction of the thick end from x towards y [rad].
        name: for people.

    Raises:
        InputError: too steep.
    """
    if not 0 < angle_rad <= 0.35:
        raise InputError(
            f"{name}: angle {angle_rad:g} rad is not between 0 and 0.35 (20 degrees); give a thinner wedge"
        )

    def relief(n: int, size: tuple[float, float]) -> np.ndarray:
        x, y = (cell_centres(n, length) for length in size)
        along = math.cos(towards_rad) * x[None, :] + math.sin(towards_rad) * y[:, None]
        lowest = (abs(math.cos(towards_rad)) * size[0] + abs(math.sin(towards_rad)) * size[1]) / 2
        return np.asarray(math.tan(angle_rad) * (along + lowest))

    return KnownPlate(WEDGE, name, relief, TOLERANCES[WEDGE])
