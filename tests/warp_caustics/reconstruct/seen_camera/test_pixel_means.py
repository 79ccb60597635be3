"""Means over the pixels that there were, against light that is simulated on a screen which is moved, or larger."""

import dataclasses

import numpy as np
import pytest
import torch

from tests.nets.reconstruct.fibres.three_lines import LINES, SCENE
from warp_caustics.extrapolated import ExtrapolatedCaustic, with_photons
from warp_caustics.prints.model import LineModel
from warp_caustics.reconstruct.base import CausticImage, Reconstruction
from warp_caustics.reconstruct.result import Resimulation
from warp_caustics.reconstruct.seen_camera.aligned_channels import channels_together, of_size
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.reconstruct.seen_camera.exact_picture import ExactPicture
from warp_caustics.reconstruct.seen_camera.pixel_means import Lay, pixel_means
from warp_caustics.reconstruct.seen_camera.point_spread import FineLight
from warp_caustics.resampling import blur_matrix
from warp_caustics.simulator import CausticSimulator

PIXELS = SCENE.image_pixels
SIMULATOR = CausticSimulator(SCENE)
INSIDE = (slice(None), slice(6, -6), slice(6, -6))


@pytest.fixture(scope="module")
def heights():
    return LineModel(SCENE).heights(LINES)


def off(found, wanted):
    """Root mean square away from the border, of flat light."""
    return float((torch.as_tensor(found) - torch.as_tensor(wanted))[INSIDE].square().mean().sqrt())


def taken(heights, shift):
    """What each channel shows whose picture lies aside, by screens that are moved the other way."""
    x, y, z = SCENE.screen_position_m
    shown = []
    for channel, (by_x, by_y) in enumerate(shift):
        moved = (x - by_x * SCENE.pixel_size_m[0], y - by_y * SCENE.pixel_size_m[1], z)
        scene = SCENE.model_copy(update={"screen_position_m": moved})
        shown.append(ExtrapolatedCaustic(CausticSimulator(scene), 8)(heights)[channel])
    return torch.stack(shown)


def test_channels_that_lay_apart(heights):
    """Half a pixel: 0.5 % of flat light, where pixels that are moved are 4 % off."""
    shift = np.array([[0.5, -0.3], [0.0, 0.0], [-0.2, 0.45]])
    camera = dataclasses.replace(ChannelCamera.perfect(3, PIXELS), shift=shift)
    shown = taken(heights, shift)
    together = channels_together(CausticImage(shown.numpy()), camera, "cpu").irradiance
    exact = ExactPicture(SIMULATOR, camera)(heights)
    where_they_belong = ExactPicture(SIMULATOR, camera.perfect(3, PIXELS))(heights)
    assert off(exact, together) < 0.005
    assert off(where_they_belong, together) > 0.03
    raw = torch.stack([pixel_means(light, PIXELS) for light in FineLight(SIMULATOR)(heights)])
    torch.testing.assert_close(exact[1], raw[1])


def test_what_the_camera_shows_lies_where_it_lay(heights):
    """A result's picture, for people to compare with what was measured."""
    shift = np.array([[0.5, -0.3], [0.0, 0.0], [-0.2, 0.45]])
    camera = dataclasses.replace(ChannelCamera.perfect(3, PIXELS), shift=shift)
    measured = taken(heights, shift)
    found = heights.double().numpy()
    plain = Resimulation(SIMULATOR, CausticImage(measured.numpy())).through(camera)
    assert off(plain.exactly().shown(found), measured) < 0.012
    assert off(plain.shown(found), measured) < 0.1 < off(plain(found).image, measured)
    assert Resimulation(SIMULATOR, CausticImage(measured.numpy())).shown(found) is None, "of a perfect camera"
    exact, seen = plain.exactly(), np.array(plain.image.irradiance)
    assert exact(found).residual < 0.5 * plain(found).residual and seen.shape == (3, PIXELS, PIXELS)


@pytest.mark.parametrize("size", [0.985, 1.0021, 1.003, 1.01])
def test_a_picture_of_another_size(heights, size):
    """Brought back: against pixels that are simulated smaller or larger about the middle, as another screen has."""
    k = 16
    light = with_photons(SIMULATOR, 2 * (k * PIXELS) ** 2, k * PIXELS)(heights).detach()
    # By areas on pixels that are finer by far, not by a spline.
    edges = (np.arange(PIXELS + 1) - PIXELS / 2) / size + PIXELS / 2
    cumulative = np.pad(light.double().numpy().cumsum(1).cumsum(2), ((0, 0), (1, 0), (1, 0)))
    at = edges * k
    low = np.clip(at.astype(int), 0, k * PIXELS - 1)
    part = at - low
    rows = cumulative[:, low] * (1 - part)[:, None] + cumulative[:, low + 1] * part[:, None]
    both = rows[:, :, low] * (1 - part) + rows[:, :, low + 1] * part
    shown = np.diff(np.diff(both, axis=1), axis=2) / (k / size) ** 2
    back = of_size(CausticImage(shown.astype(np.float32)), 1 / size, "cpu").irradiance
    camera = dataclasses.replace(ChannelCamera.perfect(3, PIXELS), size=size)
    exact = ExactPicture(SIMULATOR, camera)(heights)
    where_it_belongs = ExactPicture(SIMULATOR, camera.perfect(3, PIXELS))(heights)
    assert off(exact, back) < 0.003
    assert off(where_it_belongs, back) > 5 * off(exact, back)


def test_the_picture_of_a_result_is_what_the_camera_shows():
    image, shown = np.zeros((1, 4, 4)), np.ones((1, 4, 4))
    plain = Reconstruction("direct", np.zeros((2, 2)), image, 0.0, "converged")
    assert plain.picture is image and dataclasses.replace(plain, shown=shown).picture is shown


def test_even_light_stays_even():
    even = torch.ones(64, 64)
    lay = Lay((0.4, -0.3), 0.01, 0.99)
    torch.testing.assert_close(pixel_means(even, 16, 0.5, 0.3, lay), torch.ones(16, 16))


def test_a_camera_whose_channels_lie_where_they_belong_has_no_lays():
    camera = ChannelCamera.perfect(2, 16)
    assert camera.lays is None
    apart = dataclasses.replace(camera, shift=np.array([[0.1, 0.2], [0.0, 0.0]]))
    assert apart.lays == [Lay((0.1, 0.2), 0.0, 1.0), Lay()] and apart.of_channel(0).lays == [Lay((0.1, 0.2))]


@pytest.mark.parametrize("lay", [Lay(), Lay((0.3, -0.2), 0.001), Lay((0.3, -0.2), 0.001, 1.01, True, 1.01)])
@pytest.mark.parametrize("lens_px", [0.0, 0.4, 0.9])
def test_a_lens_before_pixels_is_light_that_was_blurred(lay, lens_px):
    """By the matrix of all fine pixels, which is not made."""
    pixels, k = 16, 6
    light = torch.from_numpy(np.random.default_rng(0).random((k * pixels, k * pixels)))
    blur = blur_matrix(k * pixels, k * lens_px)
    expected = pixel_means(blur @ light @ blur, pixels, lay=lay)
    torch.testing.assert_close(pixel_means(light, pixels, lens_px, lay=lay), expected, atol=1e-13, rtol=0)
