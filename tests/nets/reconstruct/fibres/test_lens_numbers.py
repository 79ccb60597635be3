"""Weights of a point spread as numbers."""

import dataclasses

import numpy as np
import pytest
import torch

from nets.reconstruct.fibres.bench.lens_numbers import (
    LENS_PRIOR,
    LENS_STEP,
    PAIRS,
    count_of,
    derivatives,
    moved,
    sharpened,
    widened,
)
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
    return moved(
        dataclasses.replace(PERFECT, blur=np.full(3, 0.5), spread=spread), np.repeat([0.02, 0.0], [3 * PAIRS, 3])
    )


def test_weights_stay_alike_to_both_sides_and_lose_no_light(camera):
    step = np.random.default_rng(0).standard_normal(3 * (PAIRS + 1))
    weights = moved(camera, 0.1 * step).spread.weights
    np.testing.assert_allclose(weights.sum((1, 2)), 1.0)
    np.testing.assert_allclose(weights, weights[:, ::-1, ::-1])
    again = moved(moved(camera, 0.1 * step), -0.1 * step)
    np.testing.assert_allclose(again.spread.weights, camera.spread.weights, atol=1e-12)
    np.testing.assert_allclose(again.spread.lens_px, camera.spread.lens_px)


def test_a_camera_whose_spread_is_not_known_has_none():
    assert count_of(PERFECT) == 0 and moved(PERFECT, np.zeros(0)) is PERFECT


def test_pictures_are_linear_in_them(camera):
    heights, simulator = LineModel(SCENE).heights(LINES), CausticSimulator(SCENE)
    assert count_of(camera) == 3 * (PAIRS + 1)
    bare = sharpened(camera)
    assert (bare.spread.weights[:, REACH, REACH] == 1).all() and not bare.spread.halos.any()
    step = 0.05 * np.random.default_rng(1).standard_normal(count_of(camera))
    step[3 * PAIRS :] = 0.0

    def picture(camera):
        return ExactPicture(simulator, camera)(heights)

    rows = list(derivatives(*map(picture, (bare, widened(camera, 1 - LENS_STEP), widened(camera, 1 + LENS_STEP)))))
    expected = torch.zeros(3, SCENE.image_pixels, SCENE.image_pixels)
    for number, (channel, change) in zip(step, rows, strict=True):
        expected[channel] += number * change
    torch.testing.assert_close(picture(moved(camera, step)) - picture(camera), expected, atol=2e-5, rtol=1e-3)
    wider = np.zeros(count_of(camera))
    wider[3 * PAIRS + 1] = 0.05
    changed = picture(moved(camera, wider)) - picture(camera)
    assert rows[-2][0] == 1 and not changed[[0, 2]].any()
    torch.testing.assert_close(changed[1], 0.05 * rows[-2][1], atol=1e-4, rtol=0.02)


def test_a_lens_is_as_much_wider_as_is_said(camera):
    step = np.zeros(count_of(camera))
    step[3 * PAIRS :] = 0.0, 1.0, -1.0
    widths = moved(camera, step).spread.lens_px / camera.spread.lens_px
    np.testing.assert_allclose(widths, np.exp([0.0, LENS_PRIOR, -LENS_PRIOR]))
    np.testing.assert_allclose(widened(camera, 1.5).spread.lens_px, 0.75)
