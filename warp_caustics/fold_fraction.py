"""Where light paths cross: the light map of a plate turns over, and with it the sign of its Jacobian determinant.

Exact, from a relief that is known. :mod:`warp_caustics.reconstruct.folds` estimates from an image alone whether there
are any.
"""

from functools import lru_cache

import numpy as np
import torch

from warp_caustics.height_field import basis_matrix, cell_centres, prefilter_matrix, sample_coordinate
from warp_caustics.oracle import incident_direction, refract
from warp_caustics.scene import Scene
from warp_caustics.types import BoolArray, FloatArray

POINTS_PER_SAMPLE = 2
"""Points of the plate per height sample and axis: the spline's curvature is piecewise linear between samples."""

CHUNK = 2**16

FOLD_BINS = (0.03, 0.1)
"""Bounds between few, some and many folds. The ten test fields: two, five and three."""


def fold_fraction(heights_m: FloatArray, scene: Scene) -> float:
    """Share of the plate whose light map to the screen has a negative Jacobian determinant, at the middle wavelength.

    Light that is totally reflected has no map and does not count. Exact derivatives of spline and refraction.

    Args:
        heights_m: relief above the base [m], shape [n, n].
        scene: the set-up.
    """
    determinants = jacobian_determinants(heights_m, scene)
    return float((determinants < 0).mean())


def crossing_samples(heights_m: FloatArray, scene: Scene) -> BoolArray:
    """Whether light paths cross somewhere at a sample, shape [n, n].

    Args:
        heights_m: relief above the base [m], shape [n, n].
        scene: the set-up.
    """
    n = len(heights_m)
    crossing = (jacobian_determinants(heights_m, scene) < 0).reshape(n, POINTS_PER_SAMPLE, n, POINTS_PER_SAMPLE)
    return np.asarray(crossing.any(axis=(1, 3)))


def fold_bin(fraction: float) -> str:
    """Name of the bin of a fold fraction."""
    low, high = FOLD_BINS
    if fraction < low:
        return f"below {low:.0%}"
    return f"{low:.0%} to {high:.0%}" if fraction < high else f"{high:.0%} and more"


def fold_bins() -> tuple[str, ...]:
    """Names of all bins, few folds first."""
    return tuple(fold_bin(fraction) for fraction in (0.0, FOLD_BINS[0], 1.0))


def jacobian_determinants(heights_m: FloatArray, scene: Scene) -> FloatArray:
    """Jacobian determinant of the map plate -> screen on a grid, shape [2 n, 2 n]; NaN at total reflection.

    Of the relief that was asked for last they are known; not to be written to.
    """
    return _determinants(np.ascontiguousarray(heights_m, np.float64).tobytes(), heights_m.shape, scene)


@lru_cache(maxsize=1)
def _determinants(relief: bytes, shape: tuple[int, ...], scene: Scene) -> FloatArray:
    heights_m = np.frombuffer(relief, np.float64).reshape(shape)
    points, height, slope, bend = _surface(heights_m, scene)
    chunks = [
        _determinant(points[part], height[part], slope[part], bend[part], scene)
        for part in (slice(first, first + CHUNK) for first in range(0, len(points), CHUNK))
    ]
    side = POINTS_PER_SAMPLE * scene.height_samples
    found: FloatArray = torch.cat(chunks).reshape(side, side).numpy()
    found.flags.writeable = False
    return found


def _surface(heights: FloatArray, scene: Scene) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Points [N, 2] [m], spline [N] [m], its slopes [N, 2] and second derivatives [N, 2, 2] [1/m]."""
    n, (width, length) = scene.height_samples, scene.plate_size_m
    prefilter = prefilter_matrix(n)
    coefficients = prefilter @ heights @ prefilter.T
    x, y = (cell_centres(POINTS_PER_SAMPLE * n, size) for size in (width, length))
    along_x = [basis_matrix(n, sample_coordinate(x, n, width), k) * (n / width) ** k for k in range(3)]
    along_y = [basis_matrix(n, sample_coordinate(y, n, length), k) * (n / length) ** k for k in range(3)]

    def derivative(in_x: int, in_y: int) -> FloatArray:
        values: FloatArray = (along_y[in_y] @ coefficients @ along_x[in_x].T).ravel()
        return values

    mixed = derivative(1, 1)
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    slope = np.stack([derivative(1, 0), derivative(0, 1)], axis=-1)
    bend = np.stack([derivative(2, 0), mixed, mixed, derivative(0, 2)], axis=-1).reshape(-1, 2, 2)
    return (
        torch.from_numpy(points),
        torch.from_numpy(derivative(0, 0)),
        torch.from_numpy(slope),
        torch.from_numpy(bend),
    )


def _determinant(
    points: torch.Tensor, height: torch.Tensor, slope: torch.Tensor, bend: torch.Tensor, scene: Scene
) -> torch.Tensor:
    """Determinants, shape [N]: derivatives along x and y with the surface moving along.

    Backwards, since torch loads for a second what it needs for derivatives forwards.
    """
    with torch.enable_grad():
        place, level, incline = given = [tensor.clone().requires_grad_() for tensor in (points, height, slope)]
        landing = _landing(place, level, incline, scene)
        gradients = [torch.autograd.grad(landing[:, k].sum(), given, retain_graph=True) for k in (0, 1)]
    to_x, to_y = (
        by_point + by_height[:, None] * slope + (by_slope[:, :, None] * bend).sum(1)
        for by_point, by_height, by_slope in gradients
    )
    found: torch.Tensor = to_x[:, 0] * to_y[:, 1] - to_x[:, 1] * to_y[:, 0]
    return found


def _landing(points: torch.Tensor, height: torch.Tensor, slope: torch.Tensor, scene: Scene) -> torch.Tensor:
    """Where light through points [N, 2] of heights [N] [m] and slopes [N, 2] meets the screen [m], shape [N, 2]."""
    middle = int(np.argsort(scene.wavelengths_m)[scene.n_wavelengths // 2])
    glass, outside = scene.glass_indices[middle], scene.exit_indices[middle]
    position = torch.cat([points, (scene.base_thickness_m + height)[:, None]], dim=1)
    normal = torch.cat([-slope, torch.ones_like(height)[:, None]], dim=1)
    normal = normal / torch.linalg.vector_norm(normal, dim=1, keepdim=True)
    inside = refract(incident_direction(position, scene), normal, 1.0, glass)
    position = position + inside * (position[:, 2:] / -inside[:, 2:])
    upward = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    below = refract(inside, upward, glass, outside)
    position = position + below * ((position[:, 2:] - scene.screen_position_m[2]) / -below[:, 2:])
    return position[:, :2]
