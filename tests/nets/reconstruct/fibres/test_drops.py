"""Two round drops that are told by a line between them."""

import numpy as np
import pytest
import torch

from nets.reconstruct.fibres.image.image_fit import ImageFit
from nets.reconstruct.fibres.search.drops import drops_apart, with_drops_apart
from tests.nets.reconstruct.exact_light import light_of
from warp_caustics.prints.model import LineModel
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.scene import Scene

N = 64
SCENE = Scene(height_samples=N, image_pixels=4 * N, wavelengths_m=(560e-9,), radiosity_W_m2=(1.0,))
DROPS = 1e-3 * torch.tensor(
    [
        [-2.4, 5.0, -2.4, 5.0, 4.9, 0.63],
        [-4.7, 5.9, -4.7, 5.9, 4.6, 0.83],
        [9.0, -12.0, 9.0, -12.0, 3.0, 0.4],
    ],
    dtype=torch.float64,
)
LINE = 1e-3 * torch.tensor([-15.0, -9.0, 4.0, -14.0, 2.0, 0.5], dtype=torch.float64)
BETWEEN = 1e-3 * torch.tensor(
    [
        [-2.4, 4.95, -4.7, 5.85, 4.5, 0.59],
        [-4.75, 5.9, -4.7, 5.9, 4.6, 0.26],
        [9.0, -12.0, 9.0, -12.0, 3.0, 0.4],
    ],
    dtype=torch.float64,
)


def fit_of(printed):
    model = LineModel(SCENE)
    seen = light_of(SCENE, model.heights(printed)).numpy()
    noise = np.random.default_rng(0).standard_normal(seen.shape)
    return ImageFit(SCENE, CausticImage(seen + 0.01 * noise, np.full(1, 0.01)), model, 4 * N)


def error_um(fit, lines, printed):
    return 1e6 * float((fit.model.heights(lines) - fit.model.heights(printed)).square().mean().sqrt())


def test_a_line_becomes_drops_as_high_as_all_that_is_there():
    (way,) = drops_apart(torch.cat([BETWEEN, LINE[None]]))
    assert len(way) == 4 and torch.equal(way[0], BETWEEN[2]) and torch.equal(way[1], LINE)
    for drop, end, height in zip(way[2:], (BETWEEN[0, :2], BETWEEN[0, 2:4]), (0.59e-3, 0.85e-3), strict=True):
        assert torch.equal(drop[:2], end) and torch.equal(drop[2:4], end)
        assert float(drop[5]) == pytest.approx(height) and float(drop[4]) == pytest.approx(4.5e-3)


def test_drops_that_a_line_told_are_found():
    printed = torch.cat([DROPS, LINE[None]])
    fit = fit_of(printed)
    begun = fit.descend(torch.cat([BETWEEN, LINE[None]]), 30)
    assert error_um(fit, begun.lines, printed) > 2
    found = with_drops_apart(fit, begun.lines)
    assert len(found.lines) == 4 and error_um(fit, found.lines, printed) < 0.5
    assert found.loss < begun.loss


def test_short_lines_and_drops_that_are_printed_stay():
    short = 1e-3 * torch.tensor([[-3.0, 4.0, -1.0, 5.0, 3.5, 0.7], [6.0, -9.0, 6.0, -9.0, 3.0, 0.4]])
    printed = torch.cat([short.double(), LINE[None]])
    fit = fit_of(printed)
    assert with_drops_apart(fit, printed) is None
    assert with_drops_apart(fit, torch.cat([DROPS, LINE[None]])) is None, "of no line between two"
