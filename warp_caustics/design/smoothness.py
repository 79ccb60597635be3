"""Bending energy of a relief, in units of the light that it moves."""

import torch

from warp_caustics.reconstruct.transport.ray_inversion import LightPath


def focusing_strength_m(path: LightPath) -> float:
    """Irradiance moved per curvature of the relief [m]: E - 1 = -strength Laplacian(h) for weak reliefs."""
    return (path.glass - 1) * (path.thickness_m / path.glass + path.gap_m / path.outside)


def bending_energy(heights: torch.Tensor, pitch_m: tuple[float, float], strength_m: float) -> torch.Tensor:
    """Mean of strength^2 (h_xx^2 + 2 h_xy^2 + h_yy^2) of heights [m], shape [n, n]; no unit, in float64.

    Near the square of the caustic's contrast where the relief is as smooth as that allows, more where it is rough.
    """
    h = heights.double() * strength_m
    along_x = h.diff(dim=1, n=2) / pitch_m[0] ** 2
    along_y = h.diff(dim=0, n=2) / pitch_m[1] ** 2
    mixed = h.diff(dim=0).diff(dim=1) / (pitch_m[0] * pitch_m[1])
    return along_x.square().mean() + along_y.square().mean() + 2 * mixed.square().mean()
