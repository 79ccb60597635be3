"""Ends that are hidden under other lines."""

import numpy as np
import pytest
import torch

from nets.reconstruct.fibres.image.image_fit import ImageFit
from nets.reconstruct.fibres.search.each_end import HIDDEN_FACTOR, ends_elsewhere, with_each_end
from nets.reconstruct.fibres.search.moves import stretched
from tests.nets.reconstruct.exact_light import light_of
from warp_caustics.prints.line_shape import Shape
from warp_caustics.prints.model import LineModel
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.scene import Scene

N = 64
SCENE = Scene(height_samples=N, image_pixels=4 * N, wavelengths_m=(560e-9,), radiosity_W_m2=(1.0,))
LINES = 1e-3 * torch.tensor(
    [
        [-20.0, -4.0, 20.0, 3.0, 3.0, 1.6],
        [-18.0, 5.0, 19.0, -6.0, 2.4, 1.5],
        [-1.5, -19.0, 1.5, 18.0, 3.2, 1.4],
        [-14.0, -15.0, 0.4, 0.2, 0.6, 0.25],
    ],
    dtype=torch.float64,
)
"""The last one ends where all others cross."""


def fits(overlap):
    model = LineModel(SCENE)
    model.shape = Shape(overlap=overlap)
    seen = light_of(SCENE, model.heights(LINES)).numpy()
    noise = np.random.default_rng(0).standard_normal(seen.shape)
    image = CausticImage(seen + 0.01 * noise, np.full(1, 0.01))
    return ImageFit(SCENE, image, model, 4 * N), ImageFit(SCENE, image, model, 2 * N)


def test_ends_that_are_right_stay():
    fit, quick = fits(1.0)
    assert not ends_elsewhere(quick, LINES) and with_each_end(fit, LINES, quick) is None


@pytest.mark.parametrize(("overlap", "step"), [(1.0, 6e-4), (0.8, 6e-4), (0.8, 9e-4)])
def test_a_hidden_end_is_moved_to_where_it_belongs(overlap, step):
    fit, quick = fits(overlap)
    begun = LINES.clone()
    begun[3] = stretched(LINES[3], 2, step)
    losses = [quick.loss(fit.model.heights(lines)) for lines in (begun, LINES)]
    assert losses[0] < 2 * losses[1], "as an end that nothing hides would not"
    (moved,) = ends_elsewhere(quick, begun)
    assert torch.equal(moved[:3], LINES[:3]) and float((moved[3] - LINES[3]).norm()) < 2e-4
    found = with_each_end(fit, begun, quick)
    assert float((found.lines[3, 2:4] - LINES[3, 2:4]).norm()) < 8e-5
    assert found.loss == pytest.approx(fit.loss(fit.model.heights(found.lines)), rel=1e-5)


OVER_EDGE = 1e-3 * torch.tensor([[6.0, -20.0, 4.1, 24.7, 3.8, 1.1]], dtype=torch.float64)
"""Its end is 0.3 mm inside the plate's edge."""


def fits_to(lines):
    model = LineModel(SCENE)
    seen = light_of(SCENE, model.heights(lines)).numpy()
    noise = np.random.default_rng(0).standard_normal(seen.shape)
    image = CausticImage(seen + 0.01 * noise, np.full(1, 0.01))
    return ImageFit(SCENE, image, model, 4 * N), ImageFit(SCENE, image, model, 2 * N)


@pytest.mark.parametrize("beyond_m", [1.3e-3, 1.45e-3, 2.4e-3])
def test_an_end_that_shows_nothing_comes_back_onto_the_plate(beyond_m):
    """However far beyond the edge it was: its way back is tried step by step."""
    right = torch.cat([LINES[:2], OVER_EDGE])
    fit, quick = fits_to(right)
    begun = right.clone()
    begun[2] = stretched(right[2], 2, beyond_m)
    (moved,) = ends_elsewhere(quick, begun)
    assert torch.equal(moved[:2], begun[:2]) and float((moved[2] - right[2]).norm()) < 3e-4
    found = with_each_end(fit, begun, quick)
    assert float((found.lines[2, 2:4] - right[2, 2:4]).norm()) < 8e-5


def test_a_line_that_goes_over_the_edge_stays():
    right = torch.cat([LINES[:2], OVER_EDGE])
    right[2] = stretched(OVER_EDGE[0], 2, 1.5e-3)
    fit, quick = fits_to(right)
    assert not ends_elsewhere(quick, right) and with_each_end(fit, right, quick) is None


def test_ends_in_sight_are_not_tried_far():
    """What it costs are two simulations an end, and twelve more of one that is hidden."""
    _, quick = fits(1.0)
    counted, losses = [], quick.losses

    def counting(heights, about=None):
        counted.append(len(heights))
        return losses(heights, about)

    quick.losses = counting
    ends_elsewhere(quick, LINES)
    now = losses(quick.model.heights(LINES)[None])[0]
    near = stretched(LINES[0], 0, 2.5e-4)
    assert losses(quick.model.heights(torch.cat([near[None], LINES[1:]]))[None])[0] > HIDDEN_FACTOR * now
    assert counted[0] == 1 and counted[1:4] == [4, 4, 4]
