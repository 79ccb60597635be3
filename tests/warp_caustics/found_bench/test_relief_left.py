"""What is left of even light, as relief: closed forms, noise, and the simulator's own images."""

import numpy as np
import pytest
import scipy
import torch

from tests.nets.reconstruct.exact_light import light_of
from warp_caustics.found_bench.relief_left import LONGEST_M, as_relief, left_clearly, noise_shared, relief_left, size_of
from warp_caustics.found_bench.thin_relief import ThinRelief
from warp_caustics.reconstruct.objective import Measurement
from warp_caustics.reconstruct.rest import Rest
from warp_caustics.reconstruct.trust import Seen
from warp_caustics.scene import Scene

N, M = 64, 256
SCENE = Scene(height_samples=N, image_pixels=M)
NOISE = 0.01


def places(count):
    """Along x and y [m], shape [count, count] each."""
    along = ((np.arange(count) + 0.5) / count - 0.5) * SCENE.plate_size_m[0]
    return np.meshgrid(along, along)


def bump(count, height_m, width_m):
    """A Gaussian hill off the middle [m], and its Laplacian [1/m], shape [count, count]."""
    x, y = places(count)
    squared = ((x - 4e-3) ** 2 + (y + 6e-3) ** 2) / width_m**2
    hill = height_m * np.exp(-squared / 2)
    return hill, hill * (squared - 2) / width_m**2


def noise(seed=0):
    return NOISE * np.random.default_rng(seed).standard_normal((M, M))


def even(noise_std=NOISE):
    return np.full((M, M), noise_std**-2)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_hill_is_told_from_the_light_that_it_bends(sign):
    linear = ThinRelief.of(SCENE).linear
    _, bent = bump(M, sign * 30e-6, 1e-3)
    found = as_relief(-linear * bent + noise(), even(), SCENE)
    true, _ = bump(N, sign * 30e-6, 1e-3)
    near = np.abs(true) > 3e-6
    assert found.shape == (N, N)
    assert np.abs(found - true)[near].max() < 0.25 * 30e-6
    assert np.abs(found).argmax() == np.abs(true).argmax()


def test_a_hill_is_told_from_its_simulated_image():
    true, _ = bump(N, 20e-6, 1.2e-3)
    simulated = light_of(SCENE, torch.from_numpy(true)).numpy().mean(axis=0)
    found = as_relief(simulated / simulated.mean() - 1 + 0.2 * noise(), even(0.2 * NOISE), SCENE)
    # What is long of it is not told.
    assert 0.6 < found.max() / true.max() < 1.1 and np.corrcoef(found.ravel(), true.ravel())[0, 1] > 0.85


def test_noise_is_no_relief():
    for seed in range(8):
        assert not as_relief(noise(seed), even(), SCENE).any()
    # Less than flat frames are wrong by, however little noise there is.
    x, _ = places(M)
    assert not as_relief(2e-3 * np.sin(2 * np.pi * x / 4e-3), even(1e-5), SCENE).any()


FINE = SCENE.model_copy(update={"image_pixels": 512})


def speckle(seed=0, wide_px=1.0):
    """As noisy, but neighbours share it; of twice as many pixels."""
    white = np.random.default_rng(seed).standard_normal((512, 512))
    grain = scipy.ndimage.gaussian_filter(white, wide_px, mode="wrap") if wide_px else white
    return NOISE * grain / grain.std()


def test_speckle_is_no_relief():
    """Its means err more than those of white noise; a hill that bends light by more is told beside it, and alone."""
    weight = np.full((512, 512), NOISE**-2)
    for seed in range(6):
        assert not as_relief(speckle(seed), weight, FINE).any()
    linear, (_, bent) = ThinRelief.of(FINE).linear, bump(512, 100e-6, 1e-3)
    true, _ = bump(N, 100e-6, 1e-3)
    found = as_relief(speckle(1) - linear * bent, weight, FINE)
    assert 0.6 < found.max() / true.max() < 1.1 and np.abs(found).argmax() == np.abs(true).argmax()
    x, y = places(N)
    assert np.abs(found[np.hypot(x - 4e-3, y + 6e-3) > 8e-3]).max() < 5e-6


@pytest.mark.parametrize("wide_px", [0.0, 1.0])
def test_noise_is_told_by_waves_shorter_than_a_relief_has(wide_px):
    """Of neighbours that share it, nearly what it is in longer ones; places where something is count for little."""
    pixels, alone = 4.0, np.ones((512, 512), bool)
    alone[:, 100:130] = False
    rough = speckle(0, wide_px) / NOISE
    rough[40:50, 20:30] += 3.0
    expected = scipy.ndimage.gaussian_filter(speckle(9, wide_px) / NOISE, pixels).std() * np.sqrt(4 * np.pi) * pixels
    found = noise_shared(np.where(alone, rough, 0.0), alone, pixels)
    assert found == pytest.approx(expected, rel=0.25)
    assert noise_shared(rough, np.zeros_like(alone), pixels) == 1.0


def test_light_that_grows_over_the_plate_is_no_relief():
    """A slope of one per cent, which flat frames have, would be a millimetre."""
    x, _ = places(M)
    slope = 0.01 * x / x.max()
    wave = 0.01 * np.sin(2 * np.pi * x / 4e-3)
    found, waved = (size_of(as_relief(light, even(0.5 * NOISE), SCENE)).max() for light in (slope, wave))
    linear = ThinRelief.of(SCENE).linear
    assert waved == pytest.approx(0.01 * (4e-3 / (2 * np.pi)) ** 2 / linear / np.sqrt(2), rel=0.3)
    assert found < 3 * 0.01 * (LONGEST_M / (2 * np.pi)) ** 2 / linear


def test_what_is_left_at_lines_does_not_count():
    _, bent = bump(M, 30e-6, 1e-3)
    light = -ThinRelief.of(SCENE).linear * bent
    assert left_clearly(light, even(), SCENE).any()
    x, y = places(M)
    weight = np.where(np.hypot(x - 4e-3, y + 6e-3) < 5e-3, 0.0, even())
    assert not left_clearly(light, weight, SCENE).any()
    assert not as_relief(light, np.zeros((M, M)), SCENE).any()


def test_the_pictures_rim_is_not_looked_at():
    """A lamp nearby, or a picture that lies aside, brings the plate's edge into it."""
    noisy = 1 + torch.from_numpy(np.stack([noise(k) for k in range(3)]))
    with_edge, inside = noisy.clone(), noisy.clone()
    with_edge[:, :, :2] -= 0.2
    inside[:, :, 60:62] -= 0.1
    for image, is_told in ((noisy, False), (with_edge, False), (inside, True)):
        measured = Measurement(image.float(), torch.ones_like(image).float(), torch.full_like(image, NOISE))
        shown = Seen(torch.ones_like(image).float(), torch.ones_like(image).float())
        assert relief_left(Rest.of(measured, shown), SCENE).any() == is_told
