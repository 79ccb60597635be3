"""Ends of lines that meet, moved together where the image is explained worst."""

import math
from types import SimpleNamespace

import pytest
import torch

from nets.reconstruct.fibres.image.image_fit import ImageFit
from nets.reconstruct.fibres.search.ends import with_moved_ends
from nets.reconstruct.fibres.search.moves import stretched
from nets.reconstruct.fibres.search.places import APART_M, cell_misfits, worst_places
from tests.nets.reconstruct.exact_light import light_of
from tests.nets.reconstruct.fibres.three_lines import SCENE, N, error_um
from warp_caustics.prints.model import LineModel
from warp_caustics.reconstruct.base import CausticImage

MEETING = 1e-3 * torch.tensor(
    [[-16.0, -3.0, 3.0, 1.0, 3.0, 0.8], [2.5, -15.0, 2.0, 2.0, 3.0, 0.8], [-18.0, 14.0, 17.0, 12.0, 4.0, 0.5]],
    dtype=torch.float64,
)
"""Two of them end on top of each other, at about (2.5, 1.5) mm."""


@pytest.fixture(scope="module")
def model():
    return LineModel(SCENE)


def meeting_image(model):
    """With 1 % noise."""
    simulated = light_of(SCENE, model.heights(MEETING))
    noise = torch.randn(simulated.shape, generator=torch.Generator().manual_seed(0))
    return CausticImage((simulated + 0.01 * noise).numpy())


@pytest.fixture(scope="module")
def fit(model):
    return ImageFit(SCENE, meeting_image(model), model, 2 * N)


def mistaken():
    """One end too short and the other too long, and a short line for what is missing."""
    lines = MEETING.clone()
    lines[0], lines[1] = stretched(lines[0], 2, -2.2e-3), stretched(lines[1], 2, 2.2e-3)
    extra = torch.tensor([[1e-3, 0.2e-3, 1.6e-3, 0.8e-3, 2e-3, 4e-4]], dtype=torch.float64)
    return torch.cat([lines, extra])


def test_the_worst_place_is_where_lines_are_wrong(model, fit):
    places = worst_places(fit, model.heights(mistaken()), 3)
    assert math.dist(places[0], (2.3e-3, 2e-3)) < 3.5e-3
    assert all(math.dist(a, b) >= APART_M for n, a in enumerate(places) for b in places[:n])
    worst, least = (float(cell_misfits(fit, model.heights(lines)).max()) for lines in (mistaken(), MEETING))
    assert least < worst / 5
    assert len(worst_places(fit, model.heights(MEETING), 10**6)) > 20


def test_ends_that_meet_move_together(model, fit):
    start = mistaken()
    found = with_moved_ends(fit, start)
    assert len(found.lines) == 3 and error_um(model, found.lines, MEETING) < 0.1 * error_um(model, start, MEETING)
    assert found.loss < 1.3 * fit.loss(model.heights(MEETING))


def test_right_ends_stay(model, fit):
    found = with_moved_ends(fit, MEETING)
    assert len(found.lines) == 3 and error_um(model, found.lines, MEETING) < 2.0


def test_what_is_tried_is_what_few_pixels_like(model, fit):
    """Ways are ranked by another fit; whether lines are better is said by the first."""
    quick = ImageFit(SCENE, meeting_image(model), model, N)
    start = mistaken()
    found = with_moved_ends(fit, start, quick)
    assert error_um(model, found.lines, MEETING) < 0.2 * error_um(model, start, MEETING)
    assert found.loss == pytest.approx(fit.loss(model.heights(found.lines)), rel=1e-4)
    blind = SimpleNamespace(model=model, loss=lambda heights: 1.0, losses=lambda heights, _: [9.0] * len(heights))
    torch.testing.assert_close(with_moved_ends(fit, start, blind).lines, start)
