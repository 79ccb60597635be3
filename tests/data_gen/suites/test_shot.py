"""The image that a method gets of a case."""

import dataclasses

import numpy as np
import pytest
import torch

from data_gen.dataset_config import PhotonConfig
from data_gen.suites.light import Light, true_heights
from data_gen.suites.shot import measured, photographed
from data_gen.suites.suites import suite_cases
from data_gen.testset import TEST_PHOTONS, field_images
from warp_caustics.camera.config import CameraConfig
from warp_caustics.camera.operator import Camera


def of(suite, row):
    return suite_cases(suite, 1, (row,))[0]


def test_ideal_images_are_those_of_the_test_set():
    """Bit by bit: ``nsfc data testset`` and ``nsfc compare --testset`` show the same."""
    photons = PhotonConfig.model_validate(TEST_PHOTONS.model_dump() | {"n_photons": 50_000})
    found = measured(of("ideal", "field"), Light("cpu", 50_000)).image
    np.testing.assert_array_equal(found.irradiance, field_images(fields=1, photons=photons)[0])
    assert found.mask is None and found.noise_std.shape == (3,)


@pytest.mark.parametrize(("suite", "row"), [("one-thing", "lamp-1m"), ("lab", "ordinary")])
def test_the_same_case_is_the_same_image(suite, row):
    """Whatever was simulated before."""
    case, light = of(suite, row), Light("cpu", 50_000)
    measured(of("one-thing", "apart-0.1"), light)
    first, second = measured(case, light), measured(case, Light("cpu", 50_000))
    np.testing.assert_array_equal(first.image.irradiance, second.image.irradiance)
    np.testing.assert_array_equal(first.heights_m, second.heights_m)
    if first.frames is not None:
        for one, other in zip(first.frames[:3], second.frames[:3], strict=True):
            np.testing.assert_array_equal(one, other)


def test_cameras_tell_relative_light(light):
    """Whatever gain, unevenness and black level: irradiance is that on the screen, but for the camera's flaws."""
    case = of("lab", "careful")
    found = measured(case, light)
    assert found.frames.photo.dtype == np.uint16 and found.frames.photo.shape == (3, 512, 512)
    true = light.behind_plate(case, found.heights_m)
    # The PSF and the noise of a careful bench, on blocks of 8 x 8 pixels.
    blocks = [image.reshape(3, 64, 8, 64, 8).mean(axis=(2, 4)) for image in (true, found.image.irradiance)]
    inside = (slice(None), slice(1, -1), slice(1, -1))
    ambient = case.camera.ambient
    expected = (blocks[0] + ambient) / (1 + ambient)
    assert np.abs(blocks[1] - expected)[inside].mean() < 0.02
    np.testing.assert_allclose(found.image.noise_std, 0.0073, rtol=0.15)


def test_noise_of_the_benches_is_what_their_titles_say(light):
    for row, noise in (("ordinary", 0.015), ("poor", 0.03), ("another", 0.01)):
        case = of("lab", row)
        flat = light.behind_flat(case)
        frames = photographed(case, flat, flat)
        middle = [frame[:, 150:350, 150:350].astype(float) for frame in frames[:3]]
        value = (middle[0] - middle[1].mean()) / (middle[2].mean(axis=(1, 2), keepdims=True) - middle[1].mean())
        # Local: uneven light is no noise. Neighbours of one row differ by the root of 2 of it; speckle is correlated.
        spread = value.std(axis=(1, 2)) if row == "another" else np.diff(value, axis=2).std(axis=(1, 2)) / np.sqrt(2)
        contrast = case.camera.sensor.speckle_contrast
        assert (spread > 0.9 * noise).all() and (spread < 1.15 * np.hypot(noise, contrast)).all(), (row, spread)


def test_a_moved_screen_is_masked_where_it_is_dark(light):
    found = measured(of("one-thing", "shift-1"), light).image
    masked = ~found.mask
    assert 0 < masked.sum() <= 3 * 2 * 512
    assert masked[:, 2:-2, 2:-2].sum() == 0


def test_light_of_a_lamp_is_relative_to_its_flat_plate(light):
    """Far from the relief the irradiance is 1, though a near lamp lights the rim less."""
    case = of("one-thing", "lamp-0.3m")
    assert light.behind_flat(case)[:, :8, :8].mean() < 0.985
    clean = Light("cpu", 4_000_000)
    image = measured(case, clean).image.irradiance
    is_bare = np.abs(image - 1) < 0.2
    assert np.median(image[is_bare]) == pytest.approx(1, abs=0.01)


def test_blur_keeps_light_and_shift_moves_it(light):
    plain, blurred, moved = (
        measured(of("one-thing", row), light).image.irradiance for row in ("nothing", "blur-2", "shift-1")
    )
    assert blurred.mean() == pytest.approx(plain.mean(), rel=2e-3)
    assert blurred.std() < 0.9 * plain.std()
    assert not np.allclose(plain, moved)
    # The phase of the correlation tells by how much: one pixel, in the plate's own direction.
    spectrum = np.fft.rfft2(plain[1]) * np.conj(np.fft.rfft2(moved[1]))
    rows, columns = np.fft.fftfreq(512)[:40, None], np.fft.rfftfreq(512)[None, :40]
    phase = np.angle(spectrum[:40, :40])
    weight = np.abs(spectrum[:40, :40])
    design = np.stack([(rows + 0 * columns).ravel(), (columns + 0 * rows).ravel()], axis=1) * 2 * np.pi
    weighted = design * weight.ravel()[:, None]
    found = np.linalg.lstsq(weighted, phase.ravel() * weight.ravel(), rcond=None)[0]
    assert np.hypot(*found) == pytest.approx(1, abs=0.1)


def test_a_lens_shows_the_picture_where_its_camera_does(light):
    """As the camera's own operator places it, but for what that loses of the finest parts; not the other way."""
    case = of("lab", "ordinary")
    away = case.camera.model_copy(update={"shift_px": tuple(20 * by for by in case.camera.shift_px)})
    heights = true_heights(case)
    found = light.behind_plate(dataclasses.replace(case, camera=away), heights)
    plain = torch.from_numpy(light.behind_plate(dataclasses.replace(case, camera=None), heights))
    placing = {name: getattr(away, name) for name in ("psf_px", "shift_px")}

    def off(sign: float) -> float:
        moved = tuple(sign * by for by in away.shift_px)
        seen = Camera(CameraConfig(**placing | {"shift_px": moved}), case.scene)(plain).numpy()
        return float(np.sqrt(np.mean((seen - found)[:, 8:-8, 8:-8] ** 2)))

    assert off(1.0) < 0.1 * off(-1.0)
