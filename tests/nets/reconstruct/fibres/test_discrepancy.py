"""What lines leave of an image: asked where light was moved, and place by place."""

import numpy as np
import pytest
import torch

from nets.reconstruct.fibres.image.discrepancy import Discrepancy, is_explained, moved_light
from nets.reconstruct.fibres.trust.uncertainty import of_lines
from nets.reconstruct.uncertainty import DIRECT_CALIBRATION
from warp_caustics.prints.model import LineModel
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.rest import local_relief
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator

SCENE = Scene(height_samples=32, image_pixels=128)
NOISE = 0.03
SHORT = torch.tensor([[-0.008, -0.012, 0.002, -0.01, 3e-3, 6e-4]], dtype=torch.float64)
OTHER = torch.tensor([[0.006, 0.008, 0.014, 0.012, 3e-3, 6e-4]], dtype=torch.float64)
"""Two lines far apart, [x_0, y_0, x_1, y_1, width, height] [m]; the rest of the plate is bare."""


@pytest.fixture(scope="module")
def model():
    return LineModel(SCENE, "cosine", "cpu")


def relief(model, *lines):
    return model.heights(torch.cat(lines)).double().numpy()


def image_of(heights, light=0.0):
    """With noise, and light that is not even by so much from side to side."""
    clean = CausticSimulator(SCENE)(torch.tensor(heights, dtype=torch.float32)).numpy()
    across = 1 + light * np.linspace(-1, 1, clean.shape[-1], dtype=np.float32)
    noise = np.random.default_rng(3).normal(0, NOISE, clean.shape).astype(np.float32)
    return CausticImage(clean * across + noise, np.full(3, NOISE))


def test_even_light_does_not_hide_what_lines_get_wrong(model):
    truth = relief(model, SHORT, OTHER)
    left = Discrepancy(SCENE, image_of(truth), "cpu")
    share = float(left.measurement.weight.mean() / left.whole.weight.mean())
    assert 0.03 < share < 0.5
    assert left(truth) == pytest.approx(1, abs=0.1) and left.of_all(truth) == pytest.approx(1, abs=0.05)
    wrong = 1.3 * truth
    assert is_explained(left.of_all(wrong)) and not is_explained(left(wrong))
    # What is left in even light is noise: squares go as the share of the pixels.
    expected = np.sqrt(1 + (left.of_all(wrong) ** 2 - 1) / share)
    assert left(wrong) == pytest.approx(expected, rel=0.15)


def test_a_bare_plate_and_uneven_light_count_whole(model):
    flat = np.zeros((32, 32))
    bare = Discrepancy(SCENE, image_of(flat), "cpu")
    assert torch.equal(bare.measurement.weight, bare.whole.weight)
    assert bare(flat) == bare.of_all(flat) == pytest.approx(1, abs=0.05)
    uneven = Discrepancy(SCENE, image_of(relief(model, SHORT), light=0.5), "cpu")
    assert float(uneven.measurement.weight.mean() / uneven.whole.weight.mean()) > 0.8


def test_pixels_that_do_not_count_tell_nothing():
    light, noise = torch.ones(1, 64, 64), torch.full((1, 64, 64), 0.01)
    weight = torch.ones(1, 64, 64)
    light[0, :, :20], weight[0, :, :20] = 50.0, 0.0
    assert torch.equal(moved_light(light, weight, noise), torch.ones(64, 64))
    light[0, 40, 50] = 3.0
    where = moved_light(light, weight, noise)
    assert where[40, 50] == 1 and 0 < where.sum() <= 15**2


def test_what_is_left_is_told_where_it_lies(model):
    truth, found = relief(model, SHORT, OTHER), relief(model, SHORT)
    left = Discrepancy(SCENE, image_of(truth), "cpu")
    assert not left.places(truth).any()
    places = left.places(found)
    missing, kept = relief(model, OTHER) > 1e-5, relief(model, SHORT) > 1e-4
    assert places.shape == (32, 32) and places.max() <= 1
    assert places[missing].mean() > 0.4 and not places[kept].any()
    with pytest.raises(ValueError, match="needs the noise"):
        Discrepancy(SCENE, CausticImage(image_of(truth).irradiance), "cpu").places(truth)


def test_lines_are_as_uncertain_as_what_they_leave_in_places(model):
    heights, places = relief(model, SHORT, OTHER), np.zeros((32, 32))
    spread = np.full((32, 32), 1e-6)
    where = relief(model, OTHER) > 1e-4
    places[where] = 0.5
    plain, told = (of_lines(spread, heights, None, True, 0.0, None, each) for each in (None, places))
    np.testing.assert_array_equal(told[~where], plain[~where])
    added = DIRECT_CALIBRATION.shared * 0.5 * local_relief(heights)[where]
    np.testing.assert_allclose(told[where], np.hypot(plain[where], added), rtol=1e-9)
    assert told[where].max() > 2e-5 > 10 * plain.max()
