"""Shift, scale and blur of images against closed forms and scipy; what they must keep."""

import numpy as np
import pytest
import scipy.ndimage
import torch

from data_gen.dataset_config import DatasetConfig
from data_gen.samples import Reliefs
from warp_caustics import CausticSimulator, Scene
from warp_caustics.camera.spline_pixels import filter_matrix, pixel_matrix
from warp_caustics.resampling import (
    blur_matrix,
    blurred_rows,
    gaussian_kernel,
    regridded,
    regridding_matrix,
    resampled,
    resampling_matrix,
    spline_kernel,
    spline_reach,
)

REACH = spline_reach(2.5)


def caustics(count=2):
    scene = Scene(height_samples=16, image_pixels=64)
    heights = Reliefs(DatasetConfig(kind="updater", n_samples=100, scene=scene), "cpu").true(range(count))
    return CausticSimulator(scene, "lattice")(heights)


def zeros(*shape):
    return torch.zeros(*shape)


def waves(pixels, period, shift_x=0.0, shift_y=0.0):
    """A band-limited picture, displaced exactly, shape [1, 1, m, m]."""
    along = torch.arange(pixels, dtype=torch.float64)
    x, y = (along - shift_x)[None, :], (along - shift_y)[:, None]
    picture = 1 + 0.3 * torch.sin(2 * np.pi * x / period) + 0.2 * torch.cos(2 * np.pi * (x + 2 * y) / (3 * period))
    return picture.float()[None, None]


def test_no_shift_no_scale_no_blur_is_no_change():
    images = caustics()
    same = resampled(images, zeros(2, 3, 2), zeros(2, 3), zeros(2, 3), REACH)
    assert (same - images).abs().max() < 5e-6 * images.max()


@pytest.mark.parametrize("shift", [(0.5, 0.0), (-0.3, 0.6), (1.0, -2.0)])
def test_a_shift_displaces_without_softening(shift):
    """A wave of six pixels keeps its height to 1e-4 at half a pixel, where linear interpolation loses 13 %."""
    moved = resampled(waves(64, 6.0), torch.tensor([[shift]]), zeros(1, 1), zeros(1, 1), REACH)
    expected = waves(64, 6.0, *shift)
    inside = (slice(None), slice(None), slice(8, -8), slice(8, -8))
    assert (moved - expected)[inside].abs().max() < 1e-4


def test_a_scale_magnifies_about_the_middle():
    pixels, scale = 64, 0.02
    matrix = resampling_matrix(pixels, zeros(1), torch.tensor([scale]))[0]
    found = matrix @ torch.arange(pixels, dtype=torch.float32)
    along = torch.arange(pixels) - (pixels - 1) / 2
    expected = along / (1 + scale) + (pixels - 1) / 2
    # Coordinates of up to 64 in float32.
    assert (found - expected)[20:-20].abs().max() < 5e-5


@pytest.mark.parametrize(("period", "place_px", "contrast"), [(4, 1e-3, 4e-3), (8, 1e-5, 5e-5), (32, 1e-7, 1e-6)])
def test_waves_keep_their_place_and_their_contrast(period, place_px, contrast):
    """Of 21 shifts the worst, away from the border; a windowed sinc of eight taps is up to 0.015 px off, and 0.8 %."""
    pixels, double = 160, {"dtype": torch.float64}
    wave = torch.cos(2 * np.pi * torch.arange(pixels, **double) / period).expand(pixels, pixels)
    inside = np.arange(32, 128)
    for shift in np.linspace(0, 1, 21):
        no = torch.zeros((), **double)
        moved = resampled(wave, torch.tensor([shift, 0.0], **double), no, no, REACH + 6)[80, 32:128].numpy()
        found = 2 * np.mean(moved * np.exp(-2j * np.pi * (inside - shift) / period))
        assert abs(np.angle(found)) * period / (2 * np.pi) < place_px
        assert abs(abs(found) - 1) < contrast


@pytest.mark.parametrize(("shift", "scale"), [(0.3, 0.0), (-1.7, 0.0), (0.45, 2e-3), (0.0, -0.01)])
def test_rows_are_those_of_the_camera_operator(shift, scale):
    """Which solves for the splines' coefficients instead of cutting their filter; mirrored at the border alike."""
    pixels, middle, double = 48, 23.5, {"dtype": torch.float64}
    found = resampling_matrix(pixels, torch.tensor(shift, **double), torch.tensor(scale, **double))
    edges = middle + (torch.arange(pixels + 1, **double) - 0.5 - middle - shift) / (1 + scale)
    torch.testing.assert_close(found, pixel_matrix(edges, pixels, is_dark=False), atol=1e-12, rtol=0)


def test_the_kernel_gives_the_coefficients_of_splines():
    middle = filter_matrix(101, torch.float64, torch.device("cpu"))[50]
    kernel = spline_kernel(torch.zeros((), dtype=torch.float64), 30)
    torch.testing.assert_close(kernel, middle[20:81], atol=1e-10, rtol=0)


@pytest.mark.parametrize("blur", [0.15, 0.5, 1.0, 1.6, 2.5])
def test_the_blur_has_the_width_it_says(blur):
    """Its variance is sigma^2, also far below a pixel."""
    kernel = gaussian_kernel(torch.tensor([blur]), REACH)[0].double()
    offset = torch.arange(len(kernel), dtype=torch.float64) - len(kernel) // 2
    assert float(kernel.sum()) == pytest.approx(1.0, abs=1e-6)
    # Read off the transfer function at a low frequency: tails of alternating sign would weigh in a second moment.
    omega = 0.6
    assert float((kernel * torch.cos(omega * offset)).sum()) == pytest.approx(
        np.exp(-0.5 * (blur * omega) ** 2), abs=3e-3
    )


@pytest.mark.parametrize("blur", [0.2, 0.35, 0.5, 0.7, 2.0])
def test_waves_of_a_mirrored_picture_lose_what_the_transfer_function_says(blur):
    """Cosines of half periods are what a blur that is mirrored at the border only weakens."""
    pixels, double = 48, {"dtype": torch.float64}
    half_periods = torch.arange(pixels, **double)
    waves = torch.cos(np.pi / pixels * half_periods * (torch.arange(pixels, **double)[:, None] + 0.5))
    expected = waves * torch.exp(-0.5 * (blur * np.pi / pixels * half_periods) ** 2)
    torch.testing.assert_close(blur_matrix(pixels, blur) @ waves, expected, atol=1e-12, rtol=0)


@pytest.mark.parametrize("pixels", [47, 48])
@pytest.mark.parametrize("blur", [0.0, 0.2, 0.7, 2.0, 30.0])
def test_rows_are_blurred_as_by_the_matrix(pixels, blur):
    rows = torch.from_numpy(np.random.default_rng(0).standard_normal((2, 5, pixels)))
    found = blurred_rows(rows, blur)
    torch.testing.assert_close(found, rows @ blur_matrix(pixels, blur), atol=1e-13, rtol=0)
    torch.testing.assert_close(found.sum(-1), rows.sum(-1), atol=1e-12, rtol=0)


@pytest.mark.parametrize("blur", [0.2, 0.35, 0.5, 0.7, 1.0])
def test_contrast_of_blurred_waves_does_not_depend_on_where_the_kernel_is_cut(blur):
    """Kernels within the pixels' band ring on; 0.3 % of contrast look like 0.3 % less or more stray light."""
    pixels, no, double = 160, torch.zeros((), dtype=torch.float64), {"dtype": torch.float64}
    wave = torch.cos(2 * np.pi * torch.arange(pixels, **double) / 12).expand(pixels, pixels)
    for reach in (spline_reach(blur), spline_reach(blur) + 1):
        found = resampled(wave, torch.zeros(2, **double), no, torch.tensor(blur, **double), reach)
        expected = np.exp(-0.5 * (2 * np.pi / 12 * blur) ** 2)
        assert float((found[80, 36:124] * wave[80, 36:124]).mean() / (wave[80, 36:124] ** 2).mean()) == pytest.approx(
            expected, rel=5e-4
        )


def test_blur_is_that_of_scipy():
    images = caustics(1)
    ours = resampled(images, zeros(1, 3, 2), zeros(1, 3), torch.full((1, 3), 1.4), REACH)[0, 1]
    theirs = scipy.ndimage.gaussian_filter(images[0, 1].numpy().astype(np.float64), 1.4, mode="reflect", truncate=7)
    assert np.abs(ours.numpy() - theirs).max() < 5e-3 * theirs.max()


def test_light_is_kept():
    """Shift, scale and blur move light about: all of it stays, but for what crosses the border."""
    images = torch.nn.functional.pad(caustics(1), (16, 16, 16, 16))
    changed = resampled(images, torch.full((1, 3, 2), 0.37), zeros(1, 3), torch.full((1, 3), 1.2), REACH)
    assert changed.sum() == pytest.approx(float(images.sum()), rel=1e-4)
    magnified = resampled(images, zeros(1, 3, 2), torch.full((1, 3), 0.0015), zeros(1, 3), REACH)
    assert magnified.sum() == pytest.approx(float(images.sum()) * 1.0015**2, rel=1e-3)


def test_an_even_field_stays_even():
    images = torch.ones(1, 3, 32, 32)
    changed = resampled(images, torch.full((1, 3, 2), 0.4), torch.full((1, 3), 0.01), torch.full((1, 3), 1.0), REACH)
    assert (changed - 1).abs().max() < 1e-5


def test_rows_sum_to_one_and_move_towards_larger_coordinates():
    double = {"dtype": torch.float64}
    matrix = resampling_matrix(64, torch.tensor(2.0, **double), torch.tensor(0.0, **double))
    torch.testing.assert_close(matrix.sum(1), torch.ones(64, **double))
    assert matrix[32].argmax() == 30
    still = resampling_matrix(64, torch.zeros((), **double), torch.zeros((), **double))
    torch.testing.assert_close(still, torch.eye(64, **double), atol=1e-12, rtol=0)


@pytest.mark.parametrize(("pixels", "wanted"), [(32, 64), (64, 32), (48, 64), (100, 64), (64, 64), (64, 2), (130, 64)])
def test_another_number_of_pixels_keeps_all_light(pixels, wanted):
    matrix = regridding_matrix(pixels, wanted)
    assert (matrix.sum(dim=1) - 1).abs().max() < 1e-13
    assert (matrix.sum(dim=0) * pixels / wanted - 1).abs().max() < 1e-12


@pytest.mark.parametrize(("pixels", "wanted", "tolerance"), [(64, 96, 3e-4), (64, 48, 3e-4), (64, 256, 5e-4)])
def test_pixels_of_another_grid_hold_means_of_the_same_picture(pixels, wanted, tolerance):
    """A wave of six pixels, as means over pixels in closed form, in the middle of the picture."""

    def means(count):
        edge = torch.arange(count + 1, dtype=torch.float64) / count * pixels
        integral = edge - 6 / (2 * np.pi) * torch.cos(2 * np.pi * edge / 6)
        return integral.diff() / (pixels / count)

    found = regridding_matrix(pixels, wanted) @ means(pixels)
    inside = slice(wanted // 8, -wanted // 8)
    assert (found - means(wanted))[inside].abs().max() < tolerance


def test_whole_pixels_are_binned():
    images = caustics()
    assert regridded(images, 64) is images
    binned = torch.nn.functional.avg_pool2d(images, 4)
    assert (regridded(images, 16) - binned).abs().max() < 1e-6 * images.max()
    assert (regridded(regridded(images, 128), 64) - images).abs().max() < 1e-5 * images.max()
