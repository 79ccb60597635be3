"""The lens that lines of a design tell, and the choice of parts through it."""

import dataclasses

import numpy as np
import pytest
import torch

from nets.inspection.lens_of_design import lens_of_design
from nets.inspection.selection import WIDTH, MisfitMap
from nets.reconstruct.fibres.image.image_fit import ImageFit
from nets.reconstruct.fibres.image.lines_view import LinesView
from tests.nets.reconstruct.cameras import blurring, through_lens
from tests.nets.reconstruct.fibres.three_lines import LINES, SCENE, error_um
from warp_caustics.prints.model import LineModel
from warp_caustics.reconstruct.result import Resimulation
from warp_caustics.reconstruct.seen_camera.point_spread import PointSpread
from warp_caustics.simulator import CausticSimulator

NOISE, LENS_PX, PIXELS = 0.005, 0.5, SCENE.image_pixels


@pytest.fixture(scope="module")
def model():
    return LineModel(SCENE)


def photographed(model, lines):
    return through_lens(SCENE, model.heights(lines), LENS_PX, NOISE)


@pytest.fixture(scope="module")
def image(model):
    return photographed(model, LINES)


def view_of(image, model):
    plain = Resimulation(CausticSimulator(SCENE), image)
    return LinesView(plain.through(blurring(LENS_PX, PIXELS)), model)


def fitted(lines, view):
    fit = ImageFit(view.scene, view.image, view.model, PIXELS, photons_per_pixel=8, camera=view.camera)
    fit.correct_at(view.model.heights(lines))
    return fit.descend(lines, 20).lines


def test_lines_of_a_design_tell_the_lens(model, image):
    told = view_of(image, model)
    start = fitted(LINES + 2e-5, told)
    lines, view = lens_of_design(start, told, fitted)
    np.testing.assert_allclose(view.camera.spread.lens_px, LENS_PX, atol=0.05)
    assert view.is_explained(lines) and view.left(lines) < 0.6 * told.left(start)
    assert error_um(model, lines) < error_um(model, start)


def test_a_defect_tells_no_lens(model):
    """A line that nobody designed leaves more than noise whatever the lens."""
    extra = 1e-3 * torch.tensor([[2.0, -17.0, 6.0, 15.0, 3.6, 0.6]], dtype=torch.float64)
    told = view_of(photographed(model, torch.cat([LINES, extra])), model)
    lines, view = lens_of_design(LINES, told, fitted)
    assert lines is LINES and view is told


def test_parts_are_judged_through_the_lens(model, image):
    """And without the lattice's own error: nothing but noise is left of the relief that is there."""
    relief = model.heights(LINES).double().numpy()
    misfit = MisfitMap(CausticSimulator(SCENE), image, np.full(3, LENS_PX))
    before = misfit(relief).mean()
    camera = dataclasses.replace(blurring(LENS_PX, PIXELS), spread=PointSpread.of_lens(np.full(3, LENS_PX)))
    misfit.correct_at(relief, camera)
    of_noise = np.sqrt((NOISE * np.random.default_rng(1).standard_normal(100_000)) ** 2 + WIDTH**2).mean() - WIDTH
    assert misfit(relief).mean() < 1.1 * 3 * of_noise < 0.6 * before
