"""``direct`` on other numbers of pixels and samples, other plates and wavelengths than the network's."""

import dataclasses

import numpy as np
import pytest
import torch

from data_gen.bench_ranges import bench_scene
from nets.reconstruct.methods import create
from nets.reconstruct.network_grid import NetworkGrid
from nets.reconstruct.network_io import network_image
from nets.seen_scene import scaled
from nets.shipped import find_network
from tests.nets.reconstruct.test_told_bench import NEAR, simulated
from tests.nets.reconstruct.test_told_bench import weights as told_weights
from warp_caustics.errors import MismatchError
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.resampling import regridded
from warp_caustics.scene import Scene

CPU = torch.device("cpu")
PLAIN = {"refine": False}
__all__ = ["told_weights"]


@pytest.fixture
def weights(saved):
    """A network with random weights that is told nothing."""
    return saved("direct", is_random=True)


def with_(scene, **changes):
    return scene.model_copy(update=changes)


def answer(scene, image, path, **options):
    image = image if isinstance(image, CausticImage) else CausticImage(np.asarray(image))
    return create("direct", scene, weights=path, **{**PLAIN, **options}).reconstruct(image)


def grid_of(scene, path):
    return NetworkGrid(find_network("direct", scene, path=path, any_grid=True), CPU)


def difference(one, other):
    return float(np.linalg.norm(one - other) / np.linalg.norm(other))


def test_on_its_own_grid_nothing_changes(weights, scene, image):
    grid = grid_of(scene, weights)
    assert torch.equal(grid.picture(image), network_image(image, scene, scene, CPU))
    answers = torch.rand(2, 16, 16)
    assert grid.heights(answers) is answers
    assert "sees" not in answer(scene, image, weights).settings["network"]


@pytest.mark.parametrize("pixels", [128, 192, 256, 100])
def test_more_pixels_are_means_over_the_networks(weights, scene, heights, pixels):
    """A pixel is a mean over its area, whatever it is made of: what is left is the photons' lattice and its footprints.

    They differ in the simulations of 64 and of more pixels by 1 to 3 %, and the answers by as much.
    """
    finer = with_(scene, image_pixels=pixels)
    picture = grid_of(finer, weights).picture(CausticImage(simulated(finer, heights).numpy()))
    own = simulated(scene, heights)
    assert (picture - own).norm() < 0.04 * own.norm()
    assert picture.mean() == pytest.approx(float(simulated(finer, heights).mean()), rel=1e-5)
    found = answer(finer, simulated(finer, heights), weights, causes=False)
    assert difference(found.heights_m, answer(scene, own, weights, causes=False).heights_m) < 0.04
    assert found.image.shape == (3, pixels, pixels)
    assert found.settings["network"]["sees"]["image_pixels"] == 64


def test_of_fewer_pixels_the_network_sees_what_there_is(weights, scene, heights):
    coarser = with_(scene, image_pixels=32)
    few = simulated(coarser, heights)
    grid = grid_of(coarser, weights)
    picture = grid.picture(CausticImage(few.numpy()))
    # Binned again it is what was measured: splines through means.
    assert (regridded(picture, 32) - few).abs().max() < 1e-5 * few.max()
    assert answer(coarser, few, weights).heights_m.shape == (16, 16)


@pytest.mark.parametrize("samples", [8, 32, 12, 64])
def test_heights_are_on_the_users_samples(weights, scene, heights, samples):
    """The same plate, in means over other cells; so is its uncertainty. No glass comes or goes."""
    user = with_(scene, height_samples=samples)
    image = simulated(scene, heights)
    own, found = answer(scene, image, weights), answer(user, image, weights)
    expected = regridded(torch.tensor(own.heights_m), samples).numpy()
    assert difference(found.heights_m, expected) < 1e-5
    assert found.heights_m.mean() == pytest.approx(own.heights_m.mean(), rel=1e-5)
    assert found.uncertainty_m.shape == (samples, samples) and (found.uncertainty_m >= 0).all()


@pytest.mark.parametrize("size", [0.4, 0.6, 1.6, 2.0])
def test_a_plate_with_all_lengths_scaled_has_the_heights_scaled(weights, scene, heights, size):
    """Exact in geometric optics: the images are the same to 32-bit rounding, and so are the answers."""
    user = scaled(scene, size)
    # How well a bench is known does not grow with it.
    own = answer(scene, simulated(scene, heights), weights, bench_uncertainty=False)
    found = answer(user, simulated(user, size * heights), weights, bench_uncertainty=False)
    assert difference(found.heights_m, size * own.heights_m) < 1e-3
    assert difference(found.uncertainty_m, size * own.uncertainty_m) < 1e-3
    assert found.settings["network"]["sees"]["lengths_scaled_by"] == pytest.approx(1 / size)
    assert found.residual == pytest.approx(own.residual, rel=1e-2)


def test_a_scaled_plate_is_refined_as_the_other(weights, scene, heights):
    """Steps and trusted spreads are lengths, too; what the user gives is his own.

    Adam steps along the sign of rounding where glass is flat: 3 to 12 % of the way. With steps not scaled, 37 to 148 %.
    """
    small, options = scaled(scene, 0.4), {"refine": True, "refine_iterations": 12, "symmetries": False}
    own = answer(scene, simulated(scene, heights), weights, **options)
    found = answer(small, simulated(small, 0.4 * heights), weights, **options)
    assert own.counters["refinement"] == found.counters["refinement"] == "kept"
    plain = answer(scene, simulated(scene, heights), weights, symmetries=False)
    moved = difference(own.heights_m, plain.heights_m)
    assert difference(found.heights_m, 0.4 * own.heights_m) < 0.2 * moved
    given, usual = (create("direct", small, weights=weights, **more) for more in ({"refine_step_m": 1e-6}, {}))
    assert given.refinement.refine.step_m == pytest.approx(1e-6)
    assert usual.refinement.refine.step_m == pytest.approx(3.2e-6)


def test_few_samples_are_means_of_the_relief_that_was_refined(weights, scene, heights):
    """A plate is finer than they say: heights found on them would be bent to explain the image."""
    image, user = simulated(scene, heights), with_(scene, height_samples=8)
    options = {"refine": True, "refine_iterations": 12, "symmetries": False}
    own, found = answer(scene, image, weights, **options), answer(user, image, weights, **options)
    assert own.counters["refinement"] == "kept" and found.residual == own.residual
    expected = torch.nn.functional.avg_pool2d(torch.tensor(own.heights_m)[None], 2)[0].numpy()
    np.testing.assert_allclose(found.heights_m, expected, atol=1e-12)
    assert found.settings["network"]["sees"]["refined_samples"] == 16
    start = create("direct", user, weights=weights, **PLAIN).reconstruct(CausticImage(image.numpy()), initial=expected)
    assert start.heights_m.shape == (8, 8)


def test_more_samples_than_pixels_tell_are_splines_of_fewer(weights, scene, heights):
    image, user = simulated(scene, heights), with_(scene, height_samples=32)
    options = {"refine": True, "refine_iterations": 12, "symmetries": False}
    own, found = answer(scene, image, weights, **options), answer(user, image, weights, **options)
    assert own.counters["refinement"] == "kept" and found.residual == own.residual
    expected = regridded(torch.tensor(own.heights_m), 32).numpy()
    np.testing.assert_allclose(found.heights_m, expected, atol=1e-12)
    finer = with_(user, image_pixels=128)
    assert create("direct", finer, weights=weights).refinement.scene.height_samples == 32


def test_a_told_bench_scales_with_its_plate(told_weights, scene, heights):
    bench = bench_scene(scene, **NEAR)
    user = scaled(bench, 0.6)
    own = answer(bench, simulated(bench, heights), told_weights)
    found = answer(user, simulated(user, 0.6 * heights), told_weights)
    assert difference(found.heights_m, 0.6 * own.heights_m) < 1e-3


def test_everything_at_once_is_refined_on_the_users_grid(weights, scene, heights):
    user = with_(scaled(scene, 0.6), image_pixels=100, height_samples=24)
    relief = regridded(torch.tensor(0.6 * heights), 24)
    found = answer(user, simulated(user, relief), weights, refine=True, refine_iterations=5)
    assert found.heights_m.shape == (24, 24) and found.image.shape == (3, 100, 100)
    assert found.counters["refinement"] in ("kept", "no better, discarded") and np.isfinite(found.residual)
    assert found.trust is not None


def test_the_order_of_wavelengths_does_not_matter(weights, scene, heights):
    backwards = with_(scene, wavelengths_m=scene.wavelengths_m[::-1])
    image = simulated(scene, heights)
    own, found = answer(scene, image, weights), answer(backwards, image.flip(0), weights)
    np.testing.assert_array_equal(found.heights_m, own.heights_m)


def test_other_wavelengths_are_told_by_their_index(told_weights, scene, heights):
    user = with_(scene, wavelengths_m=(650e-9, 520e-9, 450e-9))
    assert answer(user, simulated(user, heights), told_weights).heights_m.shape == (16, 16)


@pytest.mark.parametrize("wavelengths", [(530e-9,), (610e-9, 430e-9)])
def test_fewer_wavelengths_are_shown_in_all_channels(told_weights, scene, heights, wavelengths):
    user = with_(scene, wavelengths_m=wavelengths, radiosity_W_m2=(1.0,) * len(wavelengths))
    image = CausticImage(simulated(user, heights).numpy(), noise_std=np.full(len(wavelengths), 0.02))
    grid = grid_of(user, told_weights)
    picture = grid.picture(image)
    for channel, shown in enumerate(grid.seen.channels):
        assert torch.equal(picture[channel], torch.tensor(image.irradiance[shown], dtype=torch.float32))
    assert grid.noise(image) == pytest.approx(0.02)
    found = answer(user, image, told_weights, refine=True, refine_iterations=2)
    assert found.image.shape == (len(wavelengths), 64, 64)
    assert any(f"never with {len(wavelengths)}: a valley may be taken" in warning for warning in found.warnings)


def test_a_network_that_saw_one_wavelength_does_not_warn(tmp_path, told_weights, scene):
    from nets.weights import load_weights, save_weights

    loaded = load_weights(told_weights)
    training = {**loaded.info.training, "config": {"pictures": {"one_wavelength_share": 0.1}}}
    path = tmp_path / "mono.safetensors"
    save_weights(path, loaded.module, scene=scene, data_fingerprint=None, training=training)
    for count, warned in ((1, 0), (2, 1)):
        user = with_(scene, wavelengths_m=scene.wavelengths_m[:count], radiosity_W_m2=(1.0,) * count)
        found = find_network("direct", user, path=str(path), any_grid=True).warnings
        assert sum("never with" in warning for warning in found) == warned


def test_a_network_that_never_saw_few_pixels_warns(tmp_path, told_weights, scene):
    from nets.weights import load_weights, save_weights

    loaded = load_weights(told_weights)
    training = {**loaded.info.training, "config": {"pictures": {"coarse_share": 0.1}}}
    path = tmp_path / "coarse.safetensors"
    save_weights(path, loaded.module, scene=scene, data_fingerprint=None, training=training)
    for pixels, name, warned in ((32, told_weights, 1), (32, path, 0), (56, told_weights, 0), (128, told_weights, 0)):
        found = find_network("direct", with_(scene, image_pixels=pixels), path=str(name), any_grid=True).warnings
        assert sum("edges of lines are softer" in warning for warning in found) == warned


def test_prints_that_look_larger_than_any_known_are_named(scene, saved):
    """On 30 mm lines of 4 mm look 6.7 mm wide; a network that saw such lines says nothing."""
    small = scaled(scene, 0.6)

    def told(scene, **training):
        path = saved("direct", training=training)
        warnings = find_network("direct", scene, path=path, any_grid=True).warnings
        return [warning for warning in warnings if "look" in warning]

    tab_3, wide = ({"line_width_m": [1e-4, w], "line_height_m": [1e-4, w / 2]} for w in (4e-3, 8e-3))
    assert told(small, reliefs=tab_3) == [
        "lengths of this plate look 1.67 times as large to the network: of lines it knows up to 2.4 mm of width and "
        "1.2 mm of height here, larger ones are a guess"
    ]
    assert told(scene, reliefs=tab_3) == told(scaled(scene, 1.6), reliefs=tab_3) == told(small, reliefs=wide) == []
    kinds = {"bench": {"prints": [{"reliefs": tab_3}, {"reliefs": wide}, {"reliefs": {"pattern": "text"}}]}}
    assert told(small, config=kinds, reliefs=tab_3) == [] and told(small) == []


def test_a_network_that_is_told_nothing_needs_its_own_bench(weights, scene):
    """One wavelength has no dispersion to see, which makes another image than that of three."""
    for changes, message in (
        (
            {"wavelengths_m": (530e-9,), "radiosity_W_m2": (1.0,)},
            r"wavelengths_m is \(6.1e-07, .* and \(5.3e-07,\) here",
        ),
        ({"plate_size_m": (0.03, 0.03)}, "base_thickness_m is 0.0018 there and 0.003 here, .*images differ by"),
        ({"image_pixels": 31}, "is for other images: image_pixels is 31 here"),
    ):
        with pytest.raises(MismatchError, match=message) as caught:
            create("direct", with_(scene, **changes), weights=weights)
        assert "train one with: nsfc train direct" in str(caught.value) and "\n" not in str(caught.value)


def test_bounds_of_a_family_are_in_the_users_lengths(told_weights, scene):
    """A base of 5 mm on a plate of 30 mm is one of 8.3 mm on the network's, which knows 7.5 mm."""
    small = with_(scene, plate_size_m=(0.03, 0.03))
    lamp = {"emission_half_angle_rad": 0.5, "light_position_m": (0.0, 0.0, 0.1)}
    for changes, message in (
        (
            {"base_thickness_m": 5e-3},
            r"base_thickness_m is 0.005 here, the nearest that is known is 0.0045 for a plate",
        ),
        ({"base_thickness_m": 5e-4}, r"base_thickness_m is 0.0005 here, the nearest that is known is 0.0009 for"),
        (lamp, r"lamp's distance is 0.097 m here, the nearest that is known is 0.15 m for a plate of 30 mm"),
    ):
        with pytest.raises(MismatchError, match=message) as caught:
            create("direct", with_(small, image_pixels=100, **changes), weights=told_weights)
        # To train for, the pixels of the network will do.
        assert "scene.image_pixels=64" in str(caught.value)
    assert create("direct", small, weights=told_weights).asked[0].bench is not None


def test_noise_is_that_of_the_picture(weights, scene):
    """Of means over four pixels it is half; splines through fewer leave it."""
    for pixels, expected in ((128, 0.01), (64, 0.02), (32, 0.02)):
        user = with_(scene, image_pixels=pixels)
        noise = 0.02 * np.random.default_rng(0).standard_normal((3, pixels, pixels))
        image = CausticImage(1 + noise, noise_std=np.full(3, 0.02))
        grid = grid_of(user, weights)
        assert grid.noise(image) == pytest.approx(expected)
        assert float(grid.picture(image).std()) == pytest.approx(expected, rel=0.25)
    assert grid.noise(CausticImage(1 + noise)) is None


def test_saturated_pixels_are_mended_before_they_are_binned(weights, scene):
    user = with_(scene, image_pixels=128)
    irradiance, mask = np.ones((3, 128, 128)), np.ones((3, 128, 128), bool)
    irradiance[0, 40:42, 40], mask[0, 40:42, 40] = np.nan, False
    irradiance[1, 9, 9], mask[1, 9, 9] = 5.0, False
    image = CausticImage(np.nan_to_num(irradiance), mask=mask)
    picture = grid_of(user, weights).picture(image)
    assert picture[0].numpy() == pytest.approx(1.0, abs=1e-5)
    assert picture[1, 4, 4] == pytest.approx(2.0)
    found = create("direct", user, weights=weights, **PLAIN).reconstruct(CausticImage(irradiance, mask=mask))
    assert np.isfinite(found.heights_m).all()


def test_auto_takes_the_network_for_other_grids(weights, scene, heights):
    user = with_(scaled(scene, 0.6), image_pixels=128, height_samples=8)
    method = create("auto", user, weights=weights)
    image = CausticImage(simulated(with_(user, height_samples=16), 0.6 * heights).numpy())
    assert method.choose(image).plan == "fibres"


def test_fibres_run_on_the_users_grid(weights, scene, heights):
    user = with_(scene, image_pixels=128, height_samples=24)
    found = create("fibres", user, weights=weights, max_iterations=2, jumps=1).reconstruct(
        CausticImage(simulated(with_(user, height_samples=16), heights).numpy())
    )
    assert found.heights_m.shape == (24, 24)


def test_warnings_count_the_users_pixels(scene, saved):
    blurred = dataclasses.replace(ChannelCamera.perfect(3, 128), blur=np.full(3, 3.0))
    assert "blurred by 3.0 px" in blurred.warnings(scene.wavelengths_m)[0]
    assert blurred.warnings(scene.wavelengths_m, None, 4.0) == []
    path = saved("direct", training={"config": {"camera": {"shift_px": 0.6}}})
    assert create("direct", scene, weights=path).network.trained_shift_px == pytest.approx(0.6)
    finer = create("direct", with_(scene, image_pixels=128), weights=path).network
    assert finer.trained_shift_px == pytest.approx(1.2) and finer.pixels_of_one == 2


def test_the_command_trains_on_the_networks_grid(told_weights):
    user = Scene(height_samples=24, image_pixels=100, base_thickness_m=8e-3)
    with pytest.raises(MismatchError) as caught:
        create("direct", user, weights=told_weights)
    assert "scene.image_pixels=64" in str(caught.value) and "scene.image_pixels=100" not in str(caught.value)


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_a_gpu_sees_the_same(weights, scene, heights):
    user = with_(scaled(scene, 0.6), image_pixels=100, height_samples=24)
    image = CausticImage(simulated(user, regridded(torch.tensor(0.6 * heights), 24)).numpy())
    found = [create("direct", user, device=d, weights=weights, **PLAIN).reconstruct(image) for d in ("cpu", "cuda")]
    assert difference(found[1].heights_m, found[0].heights_m) < 1e-3
