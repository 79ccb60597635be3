"""Lines that were found as their sum where they lie on each other, taken apart."""

import pytest
import torch

from nets.reconstruct.fibres.image.image_fit import ImageFit
from nets.reconstruct.fibres.search.rebuild import rebuilt
from nets.reconstruct.fibres.search.sums import taken_apart, ways_through
from tests.nets.reconstruct.exact_light import light_of
from tests.nets.reconstruct.fibres.three_lines import SCENE, N, error_um
from warp_caustics.prints.model import LineModel
from warp_caustics.reconstruct.base import CausticImage

PRINTED = 1e-3 * torch.tensor(
    [[-18.0, -14.0, 12.0, 11.0, 3.4, 0.6], [-17.0, -8.0, 12.0, 11.4, 3.4, 0.5], [-9.0, 15.0, 10.0, -16.0, 3.2, 0.9]],
    dtype=torch.float64,
)
"""Two that lie on each other at one end, and one across."""
FOUND = 1e-3 * torch.tensor(
    [
        [-18.0, -14.0, 3.0, 3.5, 3.4, 0.6],
        [-17.0, -8.0, 2.8, 5.2, 3.4, 0.5],
        [3.0, 4.4, 12.0, 11.2, 3.6, 1.05],
        [-9.0, 15.0, 10.0, -16.0, 3.2, 0.9],
        [4.0, 6.0, 6.0, 7.0, 1.0, 0.1],
    ],
    dtype=torch.float64,
)
"""The same as a search ends: both end where their sum begins, beside which a short one lies."""


@pytest.fixture(scope="module")
def model():
    return LineModel(SCENE)


@pytest.fixture(scope="module")
def fit(model):
    shown = light_of(SCENE, model.heights(PRINTED)).numpy()
    return ImageFit(SCENE, CausticImage(shown), model, 2 * N)


def test_lines_go_on_through_their_sum():
    """Both, without the sum and what lies beside it, is one of the ways; one alone leaves the sum lower."""
    ways = list(ways_through(FOUND))
    both = [way for way in ways if len(way) == 3 and torch.equal(way[0], FOUND[3])]
    assert len(both) == 1
    assert float((both[0][1:, :4] - PRINTED[:2, :4]).abs().max()) < 6e-4
    rests = [way[-1] for way in ways if len(way) == 5 and torch.equal(way[-1, :5], FOUND[2, :5])]
    assert sorted(round(1e3 * float(rest[5]), 6) for rest in rests) == [0.45, 0.55]


def test_lines_across_and_single_ones_are_no_sum():
    assert not list(ways_through(FOUND[3:])) and not list(ways_through(PRINTED))


def test_the_image_has_them_go_on(model, fit):
    was = error_um(model, FOUND, PRINTED)
    found = taken_apart(fit, FOUND)
    assert found is not None and len(found.lines) == 3
    assert error_um(model, found.lines, PRINTED) < 0.2 * was
    assert found.loss < 0.5 * fit.descend(FOUND, 15).loss


def test_what_is_right_stays(fit):
    assert taken_apart(fit, PRINTED) is None


def test_places_are_built_anew_after_that(model, fit):
    heights = model.heights(FOUND)
    found = rebuilt(fit, FOUND, heights, torch.zeros_like(heights), is_enough=lambda lines: len(lines) == 3)
    assert found is not None and error_um(model, found.lines, PRINTED) < 0.2 * error_um(model, FOUND, PRINTED)
