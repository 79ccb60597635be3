"""Where on the plate lines explain an image worst."""

import math

import scipy  # loads its parts when they are first used
import torch

from nets.reconstruct.fibres.image.image_fit import ImageFit

APART_M = 2.5e-3
"""Least distance of two places [m]."""
SMOOTHED_M = 6e-4
"""Standard deviation of what misfits are averaged with [m]: the light of a place lands about it."""


def cell_misfits(fit: ImageFit, heights_m: torch.Tensor) -> torch.Tensor:
    """Mean misfit above each height sample, in units of the radiosity, shape [n, n].

    Args:
        fit: gives the measured image.
        heights_m: relief [m], shape [n, n].
    """
    with torch.no_grad():
        image = fit.seen(heights_m)
    misfit = ((image - fit.measurement.irradiance).abs() * fit.measurement.weight).mean(dim=0)
    cells: torch.Tensor = torch.nn.functional.adaptive_avg_pool2d(misfit[None], fit.model.n)[0]
    return cells


def worst_places(fit: ImageFit, heights_m: torch.Tensor, most: int) -> list[tuple[float, float]]:
    """Places of a plate whose light is explained worst, as x and y [m], the worst first.

    Args:
        fit: judges.
        heights_m: relief [m], shape [n, n].
        most: places.
    """
    scene, n = fit.model.scene, fit.model.n
    (pitch_x, pitch_y), (width, length) = scene.sample_pitch_m, scene.plate_size_m
    cells = cell_misfits(fit, heights_m).cpu().numpy()
    smooth = scipy.ndimage.gaussian_filter(cells, (SMOOTHED_M / pitch_y, SMOOTHED_M / pitch_x))
    places: list[tuple[float, float]] = []
    for at in smooth.ravel().argsort()[::-1]:
        row, column = divmod(int(at), n)
        place = (column + 0.5) * pitch_x - width / 2, (row + 0.5) * pitch_y - length / 2
        if all(math.dist(place, other) >= APART_M for other in places):
            places.append(place)
            if len(places) == most:
                break
    return places
