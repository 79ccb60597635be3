"""What a camera shows: light conserved, places to a thousandth of a pixel, widths, turns, corners, unevenness, filters, mosaics."""

import numpy as np
import pytest
import torch

from warp_caustics.camera.config import CameraConfig
from warp_caustics.camera.mosaic import demosaicked, mosaicked
from warp_caustics.camera.parameters import CameraParameters
from warp_caustics.camera.psf import psf_matrix, psf_reach
from warp_caustics.camera.radiometry import uneven_light
from warp_caustics.scene import Scene

from .conftest import WINDOW, camera, drawn, waves

ALL = CameraParameters._fields


def test_a_camera_conserves_light_in_its_frame(scene, image):
    """PSF, shift, another pixel size: the sum over the photo is that of the window by the size of pixels."""
    for magnification in (0.7, 1.0, 1.7):
        config = CameraConfig(frame_px=(64, 60), psf_px=1.2, shift_px=(0.31, 0.77), magnification=magnification)
        seen = camera(config, scene)(image)
        assert float(seen.sum()) == pytest.approx(float(image.sum()) * magnification**2, rel=1e-12)


def test_a_psf_conserves_light_also_at_the_border(scene, image):
    seen = camera(CameraConfig(psf_px=(0.4, 1.0, 2.0), box_px=1.5), scene)(image)
    torch.testing.assert_close(seen.sum((1, 2)), image.sum((1, 2)), rtol=1e-12, atol=0)


def test_an_even_field_stays_even(scene):
    seen = camera(WINDOW.model_copy(update={"light": (0.0,) * 5, "ambient": 0.0, "mixing": None, "gain": 1.0}), scene)
    one = torch.ones(3, 24, 24, dtype=torch.float64)
    assert (seen(one) - 1).abs().max() < 1e-13


@pytest.mark.parametrize("free", [(), ALL])
def test_whole_pixels_of_shift_are_exact(scene, image, free):
    seen = camera(CameraConfig(frame_px=(30, 32), shift_px=(2.0, -3.0)), scene, free=free)(image)
    expected = torch.zeros(3, 32, 30, dtype=torch.float64)
    expected[:, 1:25, 5:29] = image
    assert (seen - expected).abs().max() < 1e-12


@pytest.mark.parametrize(("period", "tolerance"), [(4.0, 2e-3), (6.0, 1.1e-4), (8.0, 2e-5)])
def test_a_shift_of_half_a_pixel_does_not_soften(period, tolerance):
    """A windowed sinc of eight taps changes a wave of 6 px by 5e-3, linear interpolation by 0.13."""
    scene = Scene(image_pixels=96, wavelengths_m=(530e-9,), radiosity_W_m2=(1.0,))
    seen = camera(CameraConfig(shift_px=(0.5, 0.3)), scene)(waves(96, 96, period)[None])
    error = (seen[0] - waves(96, 96, period, 0.5, 0.3))[24:-24, 24:-24]
    assert error.abs().max() < tolerance


def test_colours_keep_their_place_to_a_thousandth_of_a_pixel():
    """Lines some pixels wide lie where shift and scale say, for 0.05 px between channels are harmful."""
    scene = Scene(image_pixels=96)
    shifts, scales = ((0.25, -0.1), (0.0, 0.0), (-0.05, 0.3)), (0.002, 0.0, -0.001)
    x = torch.arange(96, dtype=torch.float64)
    middle, place = 47.5, 61.0
    line = torch.exp(-0.5 * ((x - place) / 1.5) ** 2).expand(3, 96, 96)
    seen = camera(CameraConfig(colour_shift_px=shifts, colour_scale=scales), scene)(line)
    centre = (seen * x).sum(-1) / seen.sum(-1)
    for channel in range(3):
        expected = middle + (1 + scales[channel]) * (place - middle) + shifts[channel][0]
        assert (centre[channel, 10:-10] - expected).abs().max() < 1e-5


def test_the_psf_has_the_width_it_says():
    """Its transfer is that of the Gaussian times that of the square, at all frequencies within the band."""
    psf, box = torch.tensor([0.15, 0.5, 1.2], dtype=torch.float64), torch.tensor([0.0, 1.0, 0.7], dtype=torch.float64)
    matrix = psf_matrix(129, psf, box, psf_reach(1.2, 1.0))
    offset = torch.arange(129, dtype=torch.float64) - 64
    for omega in (0.3, 1.0, 2.0):
        found = (matrix[:, 64] * torch.cos(omega * offset)).sum(-1)
        expected = torch.exp(-0.5 * (psf * omega) ** 2) * torch.sinc(box * omega / (2 * np.pi))
        assert (found - expected).abs().max() < 3e-3


def test_a_quarter_turn_is_a_turned_array(scene, image):
    seen = camera(CameraConfig(turn_rad=np.pi / 2), scene)(image)
    # From x towards y: what lay on the right lies below, and below is the end of the rows.
    assert (seen - torch.rot90(image, -1, (-2, -1))).abs().max() < 1e-10


def test_corners_lie_where_they_were_put(scene):
    wanted = ((8.0, 7.0), (38.0, 9.0), (36.0, 37.0), (6.0, 35.0))
    model = camera(CameraConfig(frame_px=(48, 44), corners_px=wanted), scene)
    np.testing.assert_allclose(model.corners_px(), wanted, atol=1e-10)
    turned = camera(CameraConfig(frame_px=(48, 44), turn_rad=0.02, magnification=1.2, shift_px=(1.0, 2.0)), scene)
    middle = turned.corners_px().mean(axis=0)
    np.testing.assert_allclose(middle, (23.5 + 1, 21.5 + 2), atol=1e-10)
    sides = np.linalg.norm(np.diff(turned.corners_px(), axis=0), axis=1)
    np.testing.assert_allclose(sides, 1.2 * 24, rtol=1e-12)


def test_a_photo_from_the_side_shows_light_where_the_window_is():
    """Its middle lies where the map of an independent projective transform has it."""
    from skimage.transform import ProjectiveTransform

    scene = Scene(image_pixels=64, wavelengths_m=(530e-9,), radiosity_W_m2=(1.0,))
    corners = np.array(((20, 15), (95, 22), (90, 101), (12, 92)), dtype=float)
    model = camera(CameraConfig(frame_px=(112, 110), corners_px=tuple(map(tuple, corners))), scene)
    window = np.array(((-0.5, -0.5), (63.5, -0.5), (63.5, 63.5), (-0.5, 63.5)))
    there = ProjectiveTransform.from_estimate(window, corners)
    x = torch.arange(64, dtype=torch.float64)
    for place in ((20.0, 40.0), (50.5, 12.25)):
        spot = torch.exp(-0.5 * (((x - place[0]) / 2.5)[None, :] ** 2 + ((x - place[1]) / 2.5)[:, None] ** 2))[None]
        seen = model(spot)[0]
        rows, columns = torch.meshgrid(*(torch.arange(n, dtype=torch.float64) for n in seen.shape), indexing="ij")
        found = [float((seen * of).sum() / seen.sum()) for of in (columns, rows)]
        # Perspective moves the centre of a spot 2.5 px wide by a little.
        np.testing.assert_allclose(found, there(np.array([place]))[0], atol=0.05)


# --------------------------------------------------------------------- brightness


def test_uneven_light_is_one_in_the_mean():
    light = uneven_light(0.05 * drawn(4, 3, 5), 64, 48)
    assert light.shape == (4, 3, 64, 48)
    assert (light.mean(dim=(2, 3)) - 1).abs().max() < 1e-12 and light.std() > 0.01


def test_uneven_light_is_its_polynomial():
    coefficients = torch.tensor([[0.01, 0.02, 0.03, 0.04, 0.05]], dtype=torch.float64)
    y, x = np.mgrid[:40, :30].astype(float)
    x, y = (x + 0.5) / 15 - 1, (y + 0.5) / 20 - 1
    squares = (x**2 - (x**2).mean(), y**2 - (y**2).mean())
    expected = 1 + 0.01 * x + 0.02 * y + 0.03 * squares[0] + 0.04 * x * y + 0.05 * squares[1]
    np.testing.assert_allclose(uneven_light(coefficients, 40, 30)[0], expected, atol=1e-14)


def test_filters_gains_and_ambient_light_by_hand(scene):
    scene = scene.model_copy(update={"radiosity_W_m2": (1.0, 2.0, 4.0)})
    mixing = ((0.9, 0.1, 0.0), (0.0, 1.0, 0.0))
    model = camera(CameraConfig(mixing=mixing, gain=(1.0, 0.5), ambient=(0.1, 0.2, 0.3)), scene)
    image = torch.tensor([1.0, 3.0, 5.0], dtype=torch.float64)[:, None, None].expand(3, 24, 24)
    lit = np.array([1.0 + 0.1, 3.0 + 0.4, 5.0 + 1.2])
    expected = np.array([1.0, 0.5]) * (np.array(mixing) @ lit)
    np.testing.assert_allclose(model(image)[:, 3, 7], expected, rtol=1e-12)


# --------------------------------------------------------------------- mosaic


def test_each_pixel_of_a_mosaic_holds_its_colour():
    signal = torch.arange(3.0)[:, None, None].expand(3, 4, 4)
    assert mosaicked(signal, "rggb").tolist() == [[0, 1, 0, 1], [1, 2, 1, 2]] * 2
    assert mosaicked(signal, "gbrg").tolist() == [[1, 2, 1, 2], [0, 1, 0, 1]] * 2


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "grbg", "gbrg"])
def test_demosaicing_keeps_planes_of_light_and_the_mosaic(pattern):
    """Bilinear: exact for colours that change linearly, inside; and where a filter lies its value stays."""
    y, x = torch.meshgrid(*(torch.arange(n, dtype=torch.float64) for n in (9, 12)), indexing="ij")
    signal = torch.stack((1 + 0.1 * x, 2 - 0.05 * y, 3 + 0.02 * x + 0.03 * y))
    raw = mosaicked(signal, pattern)
    full = demosaicked(raw, pattern)
    torch.testing.assert_close(full[:, 1:-1, 1:-1], signal[:, 1:-1, 1:-1], atol=1e-12, rtol=0)
    torch.testing.assert_close(mosaicked(full, pattern), raw, atol=1e-12, rtol=0)
    even_colours = torch.tensor([1.0, 2.0, 3.0], dtype=torch.float64)[:, None, None].expand(3, 9, 12)
    torch.testing.assert_close(demosaicked(mosaicked(even_colours, pattern), pattern), even_colours)


# --------------------------------------------------------------------- devices
