"""Cameras that spread points of light before their pixels and after them."""

import dataclasses

import numpy as np
import pytest
import scipy.ndimage
import scipy.signal
import torch

from tests.nets.reconstruct.fibres.three_lines import LINES, SCENE
from warp_caustics.prints.model import LineModel
from warp_caustics.reconstruct.objective import Measurement
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.reconstruct.seen_camera.exact_picture import ExactPicture
from warp_caustics.reconstruct.seen_camera.pixel_means import PLACED
from warp_caustics.reconstruct.seen_camera.point_spread import FINENESS, HALOS_PX, REACH, FineLight, PointSpread
from warp_caustics.reconstruct.seen_camera.spread_estimate import TOLD, _Search, equal_blur_px, found_spread
from warp_caustics.resampling import blur_matrices, blurred
from warp_caustics.simulator import CausticSimulator

PIXELS, NOISE = SCENE.image_pixels, 0.01
INSIDE = slice(2 * REACH, -2 * REACH)
SIMULATOR = CausticSimulator(SCENE)


@pytest.fixture(scope="module")
def heights():
    return LineModel(SCENE).heights(LINES)


@pytest.fixture(scope="module")
def fine(heights):
    return FineLight(SIMULATOR)(heights)


def binned(fine):
    return torch.nn.functional.avg_pool2d(fine, fine.shape[-1] // PIXELS)


def by_kernel(fine, kernel):
    """Through a kernel on fine pixels, told by scipy."""
    shown = [scipy.signal.fftconvolve(np.pad(c, 64, mode="symmetric"), kernel, mode="same") for c in fine.numpy()]
    return binned(torch.tensor(np.stack(shown)[:, 64:-64, 64:-64]))


def gaussian(sigma_px):
    x = np.arange(-40, 41) / FINENESS
    along = np.exp(-0.5 * (x / sigma_px) ** 2)
    return np.outer(along, along) / along.sum() ** 2


def disc(radius_px):
    x = np.arange(-40, 41) / FINENESS
    inside = np.clip((radius_px - np.hypot(x[:, None], x)) * FINENESS + 0.5, 0, 1)
    return inside / inside.sum()


def sampled(fine, sigma_px):
    return torch.tensor(
        np.stack(
            [scipy.ndimage.gaussian_filter(c.astype(float), sigma_px, mode="nearest") for c in binned(fine).numpy()]
        )
    )


def spread_of(lens_px=0.0, band_px=0.0):
    return dataclasses.replace(PointSpread.of_lens(np.full(3, lens_px)), band_px=np.full(3, band_px))


def found_in(shown, fine, blur_px):
    noise = NOISE * np.random.default_rng(0).standard_normal(shown.shape)
    image = (shown + torch.tensor(noise)).float()
    camera = dataclasses.replace(ChannelCamera.perfect(3, PIXELS), blur=np.full(3, blur_px))
    return found_spread(Measurement(image, torch.ones_like(image), None), fine, camera)


def speckled(shown, contrast, seed):
    """Pixels of which neighbours share their noise."""
    white = np.random.default_rng(seed).standard_normal(shown.shape)
    grain = scipy.ndimage.gaussian_filter(white, (0, 1, 1))
    return shown * torch.tensor(np.exp(contrast * grain / grain.std()))


def with_halos(shares, lens_px=0.5):
    return dataclasses.replace(spread_of(lens_px=lens_px), halos=np.tile(shares, (3, 1)))


def off(seen, shown):
    return float((seen - shown)[:, INSIDE, INSIDE].std())


def test_a_lens_blurs_before_the_pixels(fine):
    shown = by_kernel(fine, gaussian(0.5))
    assert off(spread_of(lens_px=0.5)(fine, PIXELS), shown) < 2e-3
    assert off(spread_of(band_px=0.5)(fine, PIXELS), shown) > 2e-2


def test_weights_are_a_convolution(fine):
    """As scipy has it, of a picture without any symmetry."""
    spread = spread_of()
    weights = np.random.default_rng(1).standard_normal((2 * REACH + 1, 2 * REACH + 1))
    weights = (weights + weights[::-1, ::-1]) / (2 * weights.sum())
    spread = dataclasses.replace(spread, weights=np.stack([weights] * 3))
    expected = scipy.ndimage.convolve(binned(fine)[1].double().numpy(), weights, mode="nearest")
    np.testing.assert_allclose(spread(fine, PIXELS)[1].numpy(), expected, atol=2e-4 * np.abs(expected).max())


def test_light_stays(fine):
    """All of it: what mirrored borders and weights that sum to 1 do."""
    spread = found_in(by_kernel(fine, disc(0.8)), fine, 0.4)
    flat = torch.ones_like(fine)
    np.testing.assert_allclose(spread(flat, PIXELS).numpy(), 1.0, atol=1e-5)


def test_fine_light_is_that_of_the_pixels(heights, fine):
    """Its mean over pixels is that of many photons on them."""
    many = CausticSimulator(SCENE, "lattice", n_photons=256 * PIXELS**2)(heights)
    assert off(binned(fine), many) < 5e-3
    plain, half = (FineLight(SIMULATOR).plain(heights, by_half=half) for half in (False, True))
    torch.testing.assert_close(2 * plain - half, fine)


@pytest.mark.parametrize(
    ("kernel", "blur_px", "most"),
    [(gaussian(0.3), 0.3, 4e-3), (gaussian(0.6), 0.6, 4e-3), (disc(0.8), 0.45, 1e-2), (disc(1.2), 0.7, 2e-2)],
)
def test_a_lens_is_found(fine, kernel, blur_px, most):
    """From an image with noise; a Gaussian in the band is some hundredths of flat light off."""
    shown = by_kernel(fine, kernel)
    sharp = binned(fine)
    found = found_in(shown, fine, blur_px)
    left = off(found(fine, PIXELS), shown)
    usual = min(
        off(blurred(sharp, blur_matrices(PIXELS, np.full(3, sigma), "cpu")), shown) for sigma in np.arange(0.2, 1, 0.05)
    )
    assert left < most
    assert left < 0.5 * usual


def test_the_width_of_a_lens_is_found(fine):
    found = found_in(by_kernel(fine, gaussian(0.5)), fine, 0.52)
    np.testing.assert_allclose(found.lens_px, 0.5, atol=0.05)
    np.testing.assert_array_equal(found.band_px, 0.0)


def test_halos_are_found(fine):
    found = found_in(with_halos([0.04, 0.01])(fine, PIXELS), fine, 0.55)
    np.testing.assert_allclose(found.halos.mean(axis=0), [0.04, 0.01], atol=0.015)
    again = found_in(speckled(with_halos([0.04, 0.01])(fine, PIXELS), 0.02, 1), fine, 0.55)
    np.testing.assert_allclose(again.halos.mean(axis=0), [0.04, 0.01], atol=0.035)
    assert (again.halos.sum(axis=1) > 0.03).all()


def test_a_halo_gives_light(fine):
    """One that takes some is none, however clearly it is told."""
    found = found_in(with_halos([-0.04, -0.01])(fine, PIXELS), fine, 0.55)
    np.testing.assert_array_equal(found.halos, 0.0)


@pytest.mark.parametrize("seed", range(4))
def test_speckle_is_no_halo(fine, seed):
    found = found_in(speckled(with_halos([0.0, 0.0])(fine, PIXELS), 0.05, seed), fine, 0.55)
    np.testing.assert_array_equal(found.halos, 0.0)


def test_strips_tell_how_well_halos_and_stray_light_are_told(fine):
    """Also where neighbours share their noise: halos of none are two squares of deviations, that of each of two."""
    shown = with_halos([0.0, 0.0])(fine, PIXELS)[1]
    told, stray, deviations = [], [], []
    for seed in range(12):
        image = 0.05 + speckled(shown[None], 0.03, seed)[0].float()
        search = _Search(fine[1], image, torch.ones_like(image), 0.55, PLACED)
        halos = search.told_halos(search.fit(0.5, 0.0))
        told.append(halos.squares)
        deviations.append(halos.stray)
        stray.append(search._wide(search._normal(0.5, 0.0).sum(0))[-1])
    assert 0.4 < np.median(told) < 4.0
    assert max(told) < TOLD * len(HALOS_PX)
    assert np.mean(stray) == pytest.approx(0.05, abs=0.01)
    assert np.std(stray) == pytest.approx(np.sqrt(np.mean(np.square(deviations))), rel=0.5)


def test_a_sampled_gaussian_is_found(fine):
    shown = sampled(fine, 0.5)
    found = found_in(shown, fine, 0.4)
    assert off(found(fine, PIXELS), shown) < 3e-3
    assert off(blurred(binned(fine), blur_matrices(PIXELS, np.full(3, 0.4), "cpu")), shown) > 8e-3


@pytest.mark.parametrize("blur_px", [0.7, 2.0])
def test_a_blur_in_the_band_stays_one(fine, blur_px):
    """Wider ones, too, of which weights alone would be cut."""
    shown = blurred(binned(fine), blur_matrices(PIXELS, np.full(3, blur_px), "cpu"))
    found = found_in(shown, fine, blur_px)
    assert off(found(fine, PIXELS), shown) < 4e-3
    np.testing.assert_allclose(equal_blur_px(binned(fine), found(fine, PIXELS)), blur_px, atol=0.03)


def test_a_channel_that_is_not_seen_keeps_its_blur(fine):
    shown = by_kernel(fine, gaussian(0.5)).float()
    counts = torch.ones_like(shown)
    counts[0] = 0
    camera = dataclasses.replace(ChannelCamera.perfect(3, PIXELS), blur=np.array([0.8, 0.5, 0.5]))
    found = found_spread(Measurement(shown, counts, None), fine, camera)
    assert (found.lens_px[0], found.band_px[0], found.weights[0, REACH, REACH]) == (0.0, 0.8, 1.0)
    np.testing.assert_allclose(found.lens_px[1:], 0.5, atol=0.05)


def test_an_even_picture_tells_nothing(fine):
    """And is no reason to fail."""
    even = torch.ones_like(fine)
    found = found_in(binned(even), even, 0.0)
    np.testing.assert_allclose(found(even, PIXELS).numpy(), 1.0, atol=1e-4)


def test_the_nearest_gaussian(fine):
    sharp = binned(fine)
    seen = blurred(sharp, blur_matrices(PIXELS, np.array([0.4, 0.9, 1.5]), "cpu"))
    np.testing.assert_allclose(equal_blur_px(sharp, seen), [0.4, 0.9, 1.5], atol=0.02)


def test_a_camera_keeps_its_spread_in_records(fine):
    spread = found_in(by_kernel(fine, disc(0.8)), fine, 0.4)
    camera = dataclasses.replace(ChannelCamera.perfect(3, PIXELS), blur=np.full(3, 0.4), spread=spread)
    again = ChannelCamera.of_record(camera.record, PIXELS)
    assert 0 < again.spread.stray == pytest.approx(spread.stray, abs=1e-6)
    np.testing.assert_allclose(again.spread(fine, PIXELS).numpy(), spread(fine, PIXELS).numpy(), atol=1e-4)
    assert camera.blurs
    assert not camera.sharp().blurs
    one = camera.of_channel(1)
    np.testing.assert_array_equal(one.spread.weights, spread.weights[1:2])
    assert one.spread.stray == spread.stray
    assert one.shift.shape == (1, 2)


def test_an_exact_picture_has_the_spread(heights, fine):
    spread = spread_of(lens_px=0.5)
    camera = dataclasses.replace(ChannelCamera.perfect(3, PIXELS), blur=np.full(3, 0.5), spread=spread)
    torch.testing.assert_close(ExactPicture(SIMULATOR, camera)(heights), spread(fine, PIXELS))
    plain = dataclasses.replace(camera, spread=None)
    assert off(ExactPicture(SIMULATOR, plain)(heights), by_kernel(fine, gaussian(0.5))) > 2e-2


@pytest.mark.parametrize("lens_px", [0.5, None])
def test_a_change_is_that_of_exact_pictures(heights, lens_px):
    """Through a lens, and where none is known."""
    spread = None if lens_px is None else spread_of(lens_px=lens_px)
    camera = dataclasses.replace(ChannelCamera.perfect(3, PIXELS), blur=np.full(3, 0.5), spread=spread)
    picture, other = ExactPicture(SIMULATOR, camera), heights.clone()
    other[5:12, 10:20] += 1e-6
    expected = picture(other) - picture(heights)
    assert float((picture.change(heights, other) - expected).norm()) < 5e-3 * float(expected.norm())


def test_a_finer_picture_is_nearer_to_the_finest(heights):
    spread = spread_of(lens_px=0.3)
    camera = dataclasses.replace(ChannelCamera.perfect(3, PIXELS), blur=np.full(3, 0.3), spread=spread)
    usual, finer, finest = (ExactPicture(SIMULATOR, camera, finer=times)(heights) for times in (1, 2, 4))
    assert off(finer, finest) < 0.3 * off(usual, finest)
    sharp = ChannelCamera.perfect(3, PIXELS)
    usual, finer, finest = (ExactPicture(SIMULATOR, sharp, finer=times)(heights) for times in (1, 2, 4))
    assert off(finer, finest) < 0.5 * off(usual, finest)
