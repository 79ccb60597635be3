"""Colour filters of a sensor: found in an image, and what they leave to be made up counts for nothing."""

import dataclasses

import numpy as np
import pytest
import torch

from warp_caustics.camera.mosaic import demosaicked, mosaicked
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.colour_filters import (
    BORDER_PX,
    PATTERNS,
    _left_by_patterns,
    found_pattern,
    moved_pixels,
    of_one_filter,
    own_pixels,
    pattern_of,
)
from warp_caustics.reconstruct.image_noise import estimated_noise
from warp_caustics.reconstruct.pyramid import check_image, measurement_at
from warp_caustics.reconstruct.result import Resimulation
from warp_caustics.reconstruct.seen_camera.aligned_channels import channels_together
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator

SCENE = Scene(height_samples=32, image_pixels=64)
CPU = torch.device("cpu")


def picture(pixels=64, noise=0.01, seed=0):
    """Lines on even light, with noise, shape [3, m, m]."""
    rng = np.random.default_rng(seed)
    x = np.arange(pixels) / pixels
    wave = 1 + 0.5 * np.sin(40 * (x[None, :] + 0.3 * x[:, None]))
    return np.stack([wave, 1.1 * wave, wave**2]) + noise * rng.standard_normal((3, pixels, pixels))


def taken(image, pattern):
    """Through filters and bilinear demosaicing."""
    return demosaicked(mosaicked(torch.as_tensor(image), pattern), pattern).numpy()


@pytest.mark.parametrize("pattern", PATTERNS)
def test_filters_are_found_as_they_lie(pattern):
    assert found_pattern(taken(picture(), pattern)) == pattern


@pytest.mark.parametrize("shape", [(3, 16, 16), (3, 33, 40)])
def test_what_patterns_leave_is_what_demosaicing_does(shape):
    image = np.random.default_rng(3).random(shape)
    inside = (..., slice(BORDER_PX, -BORDER_PX), slice(BORDER_PX, -BORDER_PX))
    for pattern, left in _left_by_patterns(image).items():
        assert left == pytest.approx(np.sqrt(np.square((image - taken(image, pattern))[inside]).mean()), rel=1e-12)


def test_a_flat_frame_of_its_own_does_not_hide_them():
    flat = taken(1 + 0.003 * np.random.default_rng(5).standard_normal((3, 64, 64)), "grbg")
    assert found_pattern(taken(picture(), "grbg") / flat) == "grbg"


@pytest.mark.parametrize(
    "image",
    [picture(), picture(noise=0), np.ones((3, 64, 64)), np.zeros((3, 64, 64)), picture()[:1], picture(8)],
    ids=["noise", "no noise", "even", "dark", "one channel", "tiny"],
)
def test_none_are_found_where_there_are_none(image):
    assert found_pattern(image) is None


def test_a_binned_mosaic_is_none():
    whole = taken(picture(128), "rggb")
    assert found_pattern(whole.reshape(3, 64, 2, 64, 2).mean((2, 4))) is None


@pytest.mark.parametrize("pattern", PATTERNS)
def test_each_pixel_belongs_to_one_channel(pattern):
    own = own_pixels(pattern, 6)
    np.testing.assert_array_equal(own.sum(0), 1)
    assert [int(each.sum()) for each in own] == [9, 18, 9] and pattern_of(own) == pattern
    for channel in own:
        assert channel[of_one_filter(channel)].all()


def test_methods_are_given_what_was_found():
    image = CausticImage(taken(picture(), "rggb"))
    checked = check_image(image, SCENE)
    np.testing.assert_array_equal(checked.own, own_pixels("rggb", 64))
    assert check_image(CausticImage(picture()), SCENE).own is None
    told = dataclasses.replace(image, own=own_pixels("bggr", 64))
    assert check_image(told, SCENE).own is told.own


def test_who_says_that_every_pixel_was_measured_is_believed():
    image = check_image(CausticImage(taken(picture(), "rggb"), own=np.ones((3, 64, 64), bool)), SCENE)
    assert not image.is_mosaic and CausticImage(image.irradiance, own=own_pixels("rggb", 64)).is_mosaic
    assert (measurement_at(image, SCENE, 64, CPU).weight == 1).all()
    assert Resimulation(CausticSimulator(SCENE), image).mosaic is None


def test_only_own_pixels_are_compared_but_all_are_binned():
    image = dataclasses.replace(CausticImage(picture()), own=own_pixels("rggb", 64))
    whole = measurement_at(image, SCENE, 64, CPU)
    np.testing.assert_array_equal(whole.weight.numpy() > 0, image.own)
    assert (measurement_at(image, SCENE, 64, CPU, made_up=True).weight == 1).all()
    assert (measurement_at(image, SCENE, 32, CPU).weight == 1).all()


def test_noise_is_that_of_pixels_that_were_measured():
    """Means of neighbours have less: half of it and more is missed where they count."""
    scene = Scene(height_samples=32, image_pixels=256)
    image = 1 + 0.02 * np.random.default_rng(2).standard_normal((3, 256, 256))
    made_up = CausticImage(taken(image, "rggb"))
    found = estimated_noise(check_image(made_up, scene), scene)
    np.testing.assert_allclose(found, 0.02, rtol=0.1)
    assert (estimated_noise(made_up, scene)[[0, 2]] < 0.013).all()


@pytest.mark.parametrize(("shift", "column"), [(0.3, 0), (0.7, 1), (-1.2, 1), (2.0, 0)])
def test_own_pixels_move_with_their_channel(shift, column):
    """To the nearest pixel: red lies at even columns."""
    moved = moved_pixels(own_pixels("rggb", 64)[0], (shift, 0.0), 0.0)
    assert (
        moved[0::2, column::2][:, 2:-2].all() and not moved[1::2].any() and not moved[:, 1 - column :: 2][:, 2:-2].any()
    )


def test_own_pixels_hold_what_was_measured_after_channels_are_brought_together():
    image = CausticImage(taken(picture(noise=0), "rggb"), own=own_pixels("rggb", 64))
    camera = dataclasses.replace(ChannelCamera.perfect(3, 64), shift=np.array([[3.0, 0], [0, 0], [0, -5.0]]))
    together = channels_together(image, camera, "cpu")
    inside = (slice(8, -8), slice(8, -8))
    red, blue = picture(noise=0)[0], picture(noise=0)[2]
    own = together.own[0][inside]
    np.testing.assert_allclose(together.irradiance[0][inside][own], np.roll(red, -3, 1)[inside][own], atol=1e-9)
    own = together.own[2][inside]
    np.testing.assert_allclose(together.irradiance[2][inside][own], np.roll(blue, 5, 0)[inside][own], atol=1e-9)


def test_the_light_of_a_mosaic_tells_the_exposure():
    """As much light is made up as is missing: the ratio is that of all pixels."""
    seen = 1.07 * taken(np.ones((3, 64, 64)) + 0.01 * picture(), "rggb")
    image = CausticImage(seen, own=own_pixels("rggb", 64))
    judge = Resimulation(CausticSimulator(SCENE), image).exposed()
    np.testing.assert_allclose(judge.exposure, seen[:, 1:-1, 1:-1].mean((1, 2)), rtol=1e-3)
    assert judge.mosaic == "rggb"
