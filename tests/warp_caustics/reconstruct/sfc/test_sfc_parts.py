"""The parts of SfC against closed forms: shrinkage, wavelets, volume, mask, data terms, step, updates."""

import numpy as np
import pytest
import torch

from warp_caustics import CausticSimulator, Scene
from warp_caustics.errors import InputError
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.objective import Measurement
from warp_caustics.reconstruct.pyramid import measurement_at
from warp_caustics.reconstruct.sfc.constraints import estimated_mask, gather, grown, oracle_mask
from warp_caustics.reconstruct.sfc.landweber import PixelUpdate, PlainUpdate, WaveletUpdate, curvature
from warp_caustics.reconstruct.sfc.shrinkage import soft_shrink
from warp_caustics.reconstruct.sfc.wavelets import WaveletBasis
from warp_caustics.reconstruct.volume import VolumeBand, relief_volume

PITCH = (1e-3, 1e-3)
SMALL = Scene(height_samples=32, image_pixels=64, plate_size_m=(0.0125, 0.0125))


def random(*shape, seed=0):
    return np.random.default_rng(seed).standard_normal(shape)


def test_soft_shrinkage_by_hand():
    values = np.array([-3.0, -1.0, -0.2, 0.0, 0.2, 1.5, 9.0])
    np.testing.assert_allclose(soft_shrink(values, 0.5), [-2.5, -0.5, 0, 0, 0, 1.0, 8.5])
    np.testing.assert_allclose(soft_shrink(values, 0.5, 0.0, 3.0), [0, 0, 0, 0, 0, 1.0, 3.0])


def test_soft_shrinkage_is_the_proximal_map():
    """It minimises (x - v)^2 / 2 + t |x| over the bounds, found here by trying a fine grid of x."""
    grid = np.linspace(-1, 2, 30001)
    for v in (-2.0, -0.31, 0.05, 0.7, 3.0):
        best = grid[np.argmin((grid - v) ** 2 / 2 + 0.3 * np.abs(grid))]
        assert soft_shrink(np.array(v), 0.3, -1.0, 2.0) == pytest.approx(best, abs=2e-4)


@pytest.mark.parametrize("samples", [32, 33])
@pytest.mark.parametrize("name", ["db3", "coif3", "bior1.5"])
def test_wavelets_reconstruct_and_transpose(samples, name):
    """S A h = h; <S c, g> = <c, S^T g>; S is linear."""
    basis = WaveletBasis(samples, name, 3)
    h, g = random(samples, samples), random(samples, samples, seed=1)
    c = random(len(basis.analyse(h)), seed=2)
    np.testing.assert_allclose(basis.synthesise(basis.analyse(h)), h, atol=1e-12)
    assert np.vdot(basis.synthesise(c), g) == pytest.approx(np.vdot(c, basis.adjoint(g)), rel=1e-10)
    np.testing.assert_allclose(basis.synthesise(2 * c + basis.analyse(h)), 2 * basis.synthesise(c) + h, atol=1e-10)


def test_norm_of_the_synthesis():
    """1 for an orthogonal wavelet; for a biorthogonal one the largest singular value of the explicit matrix."""
    assert WaveletBasis(32, "db3", 3).squared_norm() == pytest.approx(1, abs=1e-10)
    basis = WaveletBasis(8, "bior1.5", 2)
    units = np.eye(len(basis.analyse(np.zeros((8, 8)))))
    matrix = np.stack([basis.synthesise(unit).ravel() for unit in units], axis=1)
    assert basis.squared_norm(200) == pytest.approx(np.linalg.norm(matrix, 2) ** 2, rel=1e-3)


@pytest.mark.parametrize(("name", "levels", "words"), [("db99", 3, "db99"), ("db3", 6, "6 wavelet levels.*1 to 5")])
def test_wavelets_that_do_not_fit(name, levels, words):
    with pytest.raises(InputError, match=words):
        WaveletBasis(32, name, levels)


def flat_top(height_m):
    """A plateau, so that its box mean is the height itself inside."""
    heights = np.zeros((20, 20))
    heights[4:16, 4:16] = height_m
    return heights


@pytest.mark.parametrize(("ratio", "sine"), [(0.375, 1.0), (0.1875, np.sqrt(0.5)), (0.75, 0.0)])
def test_volume_below_the_band_is_pushed_up(ratio, sine):
    """V = d1/2 gives sin(pi/2); d1 = 0.75 V_printed."""
    heights = flat_top(1e-3)
    band = VolumeBand(relief_volume(heights, PITCH) / ratio)
    lifted = band.apply(heights, np.ones_like(heights), PITCH)
    assert lifted[10, 10] == pytest.approx(1e-3 * (1 + 0.1 * sine), rel=1e-9)


@pytest.mark.parametrize(("ratio", "sine"), [(1.25 * 1.25, np.sqrt(0.5)), (1.25 * 1.5, 1.0), (1.25 * 2.5, 1.0)])
def test_volume_above_the_band_is_pushed_down(ratio, sine):
    """V = 3/2 d2 gives sin(pi/2), and everything above the same: the published sine would push up at 5/2 d2."""
    heights = flat_top(1e-3)
    band = VolumeBand(relief_volume(heights, PITCH) / ratio)
    assert band.apply(heights, np.ones_like(heights), PITCH)[10, 10] == pytest.approx(1e-3 * (1 - 0.1 * sine))


def test_volume_inside_the_band_and_outside_the_mask_is_left_alone():
    heights = flat_top(1e-3)
    volume = relief_volume(heights, PITCH)
    assert volume == pytest.approx(144e-9)
    np.testing.assert_array_equal(VolumeBand(volume / 0.9).apply(heights, np.ones_like(heights), PITCH), heights)
    mask = np.zeros_like(heights)
    mask[:, :10] = 1
    lifted = VolumeBand(volume / 0.3).apply(heights, mask, PITCH)
    np.testing.assert_array_equal(lifted[:, 10:], heights[:, 10:])
    assert (lifted[5:15, 5:9] > heights[5:15, 5:9]).all()


def test_repeated_pushes_reach_the_band():
    heights, band = flat_top(1e-3), VolumeBand(relief_volume(flat_top(4e-3), PITCH))
    mask = (heights > 0).astype(float)
    for _ in range(100):
        heights = band.apply(heights, mask, PITCH)
    assert relief_volume(heights, PITCH) == pytest.approx(0.75 * band.volume_m3, rel=0.05)


def pixel_update(**changes):
    settings = {"threshold": 2.0, "lowest_m": 0.0, "highest_m": 1.0, "mask": np.ones((20, 20)), "band": None}
    return PixelUpdate(**(settings | {"sample_pitch_m": PITCH} | changes))


def test_pixel_update_by_hand():
    """h - tau g = 0.5 + 0.1 * 3 = 0.8, shrunk by tau alpha = 0.2 to 0.6; 9 is clamped to 1; the mask keeps zeros."""
    mask = np.ones((20, 20))
    mask[0] = 0
    heights = np.full((20, 20), 0.5)
    heights[5, 5] = 9
    found = pixel_update(mask=mask)(heights, np.full((20, 20), -3.0), 0.1)
    assert found[2, 2] == pytest.approx(0.6)
    assert found[5, 5] == 1
    assert (found[0] == 0).all()


def test_wavelet_update_without_threshold_is_a_gradient_step():
    """Orthogonal wavelets, no shrinkage: S (A h - tau S^T g) = h - tau g."""
    h, g = 2 + random(20, 20) / 10, random(20, 20, seed=1)
    pixels = pixel_update(threshold=0.0, highest_m=10.0)
    update = WaveletUpdate(WaveletBasis(20, "db3", 3), 0.0, pixels)
    np.testing.assert_allclose(update(h, g, 0.1), h - 0.1 * g, atol=1e-12)
    shrunk = WaveletUpdate(WaveletBasis(20, "db3", 3), 1.0, pixels)(h, g, 0.1)
    assert np.abs(shrunk).sum() < np.abs(h - 0.1 * g).sum()


def test_baseline_update_is_bounded_only_by_the_plate():
    update = PlainUpdate(-2.0, 5.0)
    np.testing.assert_array_equal(update(np.zeros(3), np.array([1.0, 30.0, -80.0]), 0.1), [-0.1, -2.0, 5.0])


@pytest.mark.parametrize("kind", ["l2", "l1"])
def test_gradient_of_the_data_term(kind):
    """Autograd in the image against central differences, with pixels that do not count."""
    image = torch.tensor(random(1, 4, 4), dtype=torch.float64, requires_grad=True)
    weight = torch.ones(1, 4, 4, dtype=torch.float64)
    weight[0, 0, :2] = 0
    measurement = Measurement(torch.zeros(1, 4, 4, dtype=torch.float64), weight, None)
    measurement.data_term(image, kind).backward()
    for row, column in ((0, 1), (2, 3), (3, 0)):
        delta = torch.zeros_like(image)
        delta[0, row, column] = 1e-6
        up, down = (float(measurement.data_term(image.detach() + s * delta, kind)) for s in (1, -1))
        assert float(image.grad[0, row, column]) == pytest.approx((up - down) / 2e-6, abs=1e-8)
    assert float(image.grad.abs().sum()) > 0


@pytest.mark.parametrize("kind", ["l2", "l1"])
def test_gradient_over_heights(kind):
    """Through the simulator, along a random direction; double precision."""
    simulator = CausticSimulator(SMALL, dtype=torch.float64)
    truth = torch.from_numpy(2e-5 * random(32, 32))
    measurement = Measurement(simulator(truth), torch.ones(3, 64, 64), None)
    heights, direction = torch.from_numpy(1e-5 * random(32, 32, seed=1)), torch.from_numpy(random(32, 32, seed=2))
    leaf = heights.clone().requires_grad_()
    measurement.data_term(simulator(leaf), kind).backward()
    up, down = (float(measurement.data_term(simulator(heights + s * 1e-10 * direction), kind)) for s in (1, -1))
    assert float((leaf.grad * direction).sum()) == pytest.approx((up - down) / 2e-10, rel=2e-3)


def test_curvature_bounds_the_step():
    """Relief of the steepest mode: gradient descent shrinks a weak error below 2 / L and blows it up above."""
    simulator = CausticSimulator(SMALL)
    flat = np.zeros((32, 32))
    measurement = measurement_at(CausticImage(simulator(torch.zeros(32, 32)).numpy()), SMALL, 64, torch.device("cpu"))
    largest = curvature(simulator, measurement, flat)

    def after(relative_step):
        heights = torch.from_numpy(1e-8 * random(32, 32)).float()
        for _ in range(20):
            leaf = heights.clone().requires_grad_()
            measurement.data_term(simulator(leaf), "l2").backward()
            heights = heights - relative_step / largest * leaf.grad
        return float(measurement.data_term(simulator(heights), "l2"))

    start = after(0.0)
    assert after(1.5) < start / 2
    assert after(2.6) > 2 * start


def test_oracle_mask_is_the_printed_relief_grown():
    """Six samples of 128, four-connected steps: a single printed sample becomes a diamond of 85 samples."""
    heights = np.zeros((128, 128))
    heights[60, 60], heights[100, 100] = 3e-5, 2e-5
    mask = oracle_mask(heights)
    assert mask.sum() == 85
    assert mask[66, 60]
    assert not mask[67, 60]
    assert not mask[100, 100]
    assert grown(np.eye(8, dtype=bool)).sum() > 8


@pytest.mark.parametrize(("samples", "pixels"), [(32, 64), (24, 64), (32, 16)])
def test_estimated_mask_finds_the_print(samples, pixels):
    """A bright spot, with 1 % noise around: the mask covers it and spares the far corner."""
    scene = Scene(height_samples=samples, image_pixels=pixels, wavelengths_m=(5e-7,), radiosity_W_m2=(2.0,))
    image = 2 + 0.02 * random(1, pixels, pixels)
    quarter = pixels // 4
    image[:, quarter : quarter + pixels // 8, quarter : quarter + pixels // 8] *= 1.5
    mask = estimated_mask(CausticImage(image, np.array([0.02])), scene)
    assert mask.shape == (samples, samples)
    assert mask[samples // 4, samples // 4]
    assert not mask[samples // 2 :, samples // 2 :].any()


def test_estimated_mask_of_unusable_pixels_and_holes():
    """What a saturated pixel hides is unknown; a ring is filled."""
    scene = Scene(height_samples=32, image_pixels=32, wavelengths_m=(5e-7,), radiosity_W_m2=(1.0,))
    image = np.ones((1, 32, 32))
    usable = np.ones_like(image, bool)
    usable[0, 5, 5] = False
    assert estimated_mask(CausticImage(image, None, usable), scene)[5, 5]
    image[0, 8:24, 8:24] = 2
    image[0, 12:20, 12:20] = 1
    assert estimated_mask(CausticImage(image), scene)[8:24, 8:24].all()


def test_gather_reads_files(tmp_path):
    scene = Scene(height_samples=16, image_pixels=32)
    image = CausticImage(np.ones((3, 32, 32)))
    mask, truth = np.zeros((16, 16), np.uint8), np.zeros((16, 16))
    mask[3:5], truth[8] = 255, 1e-4
    np.save(tmp_path / "mask.npy", mask)
    np.save(tmp_path / "truth.npy", truth)
    told = gather(str(tmp_path / "mask.npy"), "oracle", str(tmp_path / "truth.npy"), image, scene)
    np.testing.assert_array_equal(told.mask, mask > 0)
    assert (told.mask_source, told.volume_source, told.is_oracle) == ("given", "oracle", True)
    assert told.volume_m3 == pytest.approx(16 * 1e-4 * (0.05 / 16) ** 2)
