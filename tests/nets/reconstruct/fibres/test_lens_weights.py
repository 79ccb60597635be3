"""Weights of a point spread as numbers."""

import dataclasses

import numpy as np
import pytest
import torch

from nets.reconstruct.fibres.bench.lens_weights import PAIRS, count_of, derivatives, moved, sharpened
from tests.nets.reconstruct.fibres.three_lines import LINES, SCENE
from warp_caustics.prints.model import LineModel
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.reconstruct.seen_camera.exact_picture import ExactPicture
from warp_caustics.reconstruct.seen_camera.point_spread import REACH, PointSpread
from warp_caustics.simulator import CausticSimulator

PERFECT = ChannelCamera.perfect(3, SCENE.image_pixels)
WIDE = np.array([0.0, 0.02])


@pytest.fixture(scope="module")
def camera():
    spread = PointSpread.of_lens(np.full(3, 0.5))
    spread = dataclasses.replace(spread, halos=np.tile(WIDE, (3, 1)))
    return moved(dataclasses.replace(PERFECT, blur=np.full(3, 0.5), spread=spread), np.full(3 * PAIRS, 0.02))


def test_weights_stay_alike_to_both_sides_and_lose_no_light(camera):
    step = np.random.default_rng(0).standard_normal(3 * PAIRS)
    weights = moved(camera, 0.1 * step).spread.weights
    np.testing.assert_allclose(weights.sum((1, 2)), 1.0)
    np.testing.assert_allclose(weights, weights[:, ::-1, ::-1])
    again = moved(moved(camera, 0.1 * step), -0.1 * step)
    np.testing.assert_allclose(again.spread.weights, camera.spread.weights, atol=1e-12)


def test_a_camera_whose_spread_is_not_known_has_none():
    assert count_of(PERFECT) == 0 and moved(PERFECT, np.zeros(0)) is PERFECT


def test_pictures_are_linear_in_them(camera):
    heights, simulator = LineModel(SCENE).heights(LINES), CausticSimulator(SCENE)
    assert count_of(camera) == 3 * PAIRS
    bare = sharpened(camera)
    assert (bare.spread.weights[:, REACH, REACH] == 1).all() and not bare.spread.halos.any()
    step = 0.05 * np.random.default_rng(1).standard_normal(3 * PAIRS)
    here, there = (ExactPicture(simulator, each)(heights) for each in (camera, moved(camera, step)))
    expected = torch.zeros_like(here)
    rows = derivatives(ExactPicture(simulator, bare)(heights))
    for number, (channel, change) in zip(step, rows, strict=True):
        expected[channel] += number * change
    torch.testing.assert_close(there - here, expected, atol=2e-5, rtol=1e-3)
