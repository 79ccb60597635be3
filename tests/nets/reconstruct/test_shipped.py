"""The networks that come with the software."""

import numpy as np
import pytest
import torch

import nets.shipped
from data_gen.dataset_config import DatasetConfig
from data_gen.samples import Reliefs
from nets.architecture import build
from nets.config import UpdaterConfig
from nets.reconstruct.methods import create
from nets.seen_scene import scaled
from nets.shipped import FOLDER, find_network, shipped_start, shipped_weights
from nets.weights import load_weights, save_weights, weights_info
from warp_caustics.errors import MismatchError
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.resampling import regridded
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator


def test_files_are_sound_and_small():
    files = shipped_weights()
    assert "direct.safetensors" in [file.name for file in files]
    assert all(file.stat().st_size <= 16e6 for file in files)
    assert sum(file.stat().st_size for file in files) <= 40e6
    for file in files:
        assert load_weights(file).info.content_hash


@pytest.mark.parametrize("name", ["direct.safetensors", "direct-family.safetensors"])
def test_a_training_starts_from_the_network_like_its_own(name):
    assert shipped_start(weights_info(FOLDER / name).architecture) == str(FOLDER / name)


@pytest.mark.parametrize(
    ("changes", "file"),
    [
        ({}, "direct.safetensors"),
        ({"image_pixels": 1024, "height_samples": 64}, "direct.safetensors"),
        ({"image_pixels": 256}, "direct-family.safetensors"),
        ({"base_thickness_m": 4e-3}, "direct-family.safetensors"),
        ({"glass": "soda_lime", "screen_position_m": (0.0, 0.0, -1e-3)}, "direct-family.safetensors"),
        ({"wavelengths_m": (5.3e-7,), "radiosity_W_m2": (1.0,)}, "direct-family.safetensors"),
    ],
)
def test_each_scene_finds_the_network_that_knows_it_best(changes, file):
    found = find_network("direct", Scene(**changes), any_grid=True)
    assert found.file == file and not found.warnings


def weights_of(module):
    return {name: weight.clone() for name, weight in module.state_dict().items()}


def test_methods_share_what_was_read_and_none_changes_what_another_has(monkeypatch):
    read, load = [], nets.shipped.load_weights
    monkeypatch.setattr(nets.shipped, "load_weights", lambda path: read.append(path) or load(path))
    nets.shipped._kept_network.cache_clear()
    first, second = (find_network("updater", Scene()) for _ in range(2))
    assert len(read) == 1
    before = weights_of(second.module)
    assert not second.module.training and not any(each.requires_grad for each in second.module.parameters())
    first.module.register_forward_hook(lambda *_: None)
    assert not second.module._forward_hooks
    first.module.to(torch.float64).train()
    for weight in first.module.parameters():
        weight.data.zero_()
    assert not second.module.training
    for module in (second.module, find_network("updater", Scene()).module):
        assert all(torch.equal(weight, before[name]) for name, weight in module.state_dict().items())


def test_a_file_that_was_written_anew_is_read_anew(tmp_path):
    file = tmp_path / "weights.safetensors"
    scene = Scene(image_pixels=64, height_samples=16)
    for value in (0.25, 0.5):
        module = build(UpdaterConfig(), scene)
        for weight in module.parameters():
            weight.data.fill_(value)
        save_weights(file, module, scene=scene, data_fingerprint=None, training={})
        found = find_network("updater", scene, path=str(file)).module
        assert all((weight == value).all() for weight in found.parameters())


@pytest.fixture(scope="module")
def printed():
    """A field of Tab. 3 that was never trained on, seen by other photons and with 1 % of noise, at full size."""
    scene = Scene()
    config = DatasetConfig(kind="updater", n_samples=2, seed=424_242)
    truth = Reliefs(config, "cpu").true([1])
    simulator = CausticSimulator(scene, n_photons=1_500_000, placement="stratified", smoothing=5.0, seed=7)
    noise = torch.randn(3, 512, 512, generator=torch.Generator().manual_seed(7)).numpy()
    image = CausticImage(np.maximum(simulator(truth[0]).numpy() + 0.01 * noise, 0))
    heights = truth[0].double().numpy()
    assert np.sqrt((heights**2).mean()) > 4e-4
    return scene, image, heights


def test_direct_recovers_a_printed_field(printed):
    scene, image, truth = printed
    # The bench is exactly as told, the base a plane.
    exact = {"set_up": "known", "bench_uncertainty": False, "flatness_m": 0}
    result = create("direct", scene, refine=False, **exact).reconstruct(image)
    error = np.abs(result.heights_m - truth)
    assert np.sqrt((error**2).mean()) < 6e-5
    assert result.uncertainty_m is not None
    within = (error <= result.uncertainty_m).mean(), (error <= 2 * result.uncertainty_m).mean()
    assert 0.35 < within[0] < 0.95 and within[1] > 0.6  # of one field; over eighteen it was calibrated


@pytest.mark.parametrize(
    ("size", "pixels", "samples", "limit"), [(0.6, 512, 128, 6e-5), (1.0, 256, 64, 9e-5), (1.6, 171, 48, 0.0)]
)
def test_direct_serves_other_grids_and_plates(printed, size, pixels, samples, limit):
    """The same field as means over other pixels and cells, all lengths scaled: right to as much as the pixels tell."""
    scene, image, truth = printed
    user = scaled(scene, size).model_copy(update={"image_pixels": pixels, "height_samples": samples})
    seen = CausticImage(regridded(torch.tensor(image.irradiance), pixels).numpy())
    if not limit:
        with pytest.raises(MismatchError, match="image_pixels is 171 here, the nearest that it serves is 256"):
            create("direct", user)
        return
    result = create("direct", user, refine=False, symmetries=False, causes=False).reconstruct(seen)
    error = result.heights_m - size * regridded(torch.tensor(truth), samples).numpy()
    assert np.sqrt((error**2).mean()) < size * limit


@pytest.mark.parametrize(
    ("options", "file", "denoiser"),
    [
        ({}, "updater.safetensors", "denoiser.safetensors"),
        ({"denoise": False}, "updater-no-denoiser.safetensors", None),
        ({"use_gradient": False}, "updater-no-gradient.safetensors", "denoiser.safetensors"),
    ],
)
def test_the_papers_step_and_its_ablations(printed, options, file, denoiser):
    """Each finds the networks that were trained for it, and one step from flat removes most of the error.

    On a lattice: random photons as wide as the paper's are nine tenths of a step on a CPU.
    """
    scene, image, truth = printed
    result = create("nsfc", scene, max_iterations=1, photons="lattice", **options).reconstruct(image)
    used = result.settings
    assert used["network"]["file"] == file
    assert (used["denoiser"] or {}).get("file") == denoiser
    flat, found = np.sqrt((truth**2).mean()), np.sqrt(((result.heights_m - truth) ** 2).mean())
    print(f"{options}: flat {1e6 * flat:.0f} um, one step {1e6 * found:.0f} um")
    assert found < 0.5 * flat


def test_a_scene_that_looks_the_same_is_served_without_a_word():
    """Glass in the gap of 1 um changes images by 0.07 %; an index 0.0004 higher by 0.4 %, which is said."""
    file = str(FOLDER / "direct.safetensors")
    same = find_network("direct", Scene(exit_medium="glass"), path=file, any_grid=True)
    assert same.warnings == ()
    (warning,) = find_network("direct", Scene(index_offset=4e-4), path=file, any_grid=True).warnings
    assert "used because images of both differ by 0." in warning


def test_an_image_without_bright_lines_is_told_of(printed):
    scene, image, _ = printed
    options = {"symmetries": False, "refine": False, "set_up": "known", "second_opinion": False}
    faint = CausticImage((1 + 0.02 * (image.irradiance - 1)).astype(np.float32))
    with_lines, without = (create("direct", scene, **options).reconstruct(each).warnings for each in (image, faint))
    assert not any("no bright lines" in line for line in with_lines)
    assert any("no bright lines" in line and "--method refine" in line for line in without)
    asked_nothing = create("direct", scene, causes=False, **options).reconstruct(faint)
    assert not any("no bright lines" in line for line in asked_nothing.warnings)  # inspections have no --method
