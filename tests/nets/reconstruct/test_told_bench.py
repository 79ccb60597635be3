"""``direct`` with a network that is told of its bench."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml

from data_gen.bench_ranges import BenchRanges, bench_scene
from nets.architecture import build
from nets.family import check_family, family_of
from nets.reconstruct.direct_options import DirectOptions
from nets.reconstruct.fibres.options import FibresOptions
from nets.reconstruct.methods import create
from nets.reconstruct.told_bench import ToldBench
from nets.reconstruct.uncertainty import BARE_M, DIRECT_CALIBRATION, FAMILY_CALIBRATION, Calibration, uncertainty
from nets.residual_config import BackboneConfig, DirectConfig
from nets.seen_scene import seen_scene
from nets.shipped import FOLDER
from nets.symmetries import all_symmetries, transformed
from nets.weights import load_weights, save_weights
from warp_caustics.errors import MismatchError
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator

CPU = torch.device("cpu")
FAMILY = yaml.safe_load((Path(__file__).parents[3] / "configs" / "family.yaml").read_text())["training"]
RANGES = BenchRanges.model_validate(FAMILY["bench"])
BACKBONE = BackboneConfig(
    widths=(8, 12), depths=(1, 1), attention_levels=frozenset({1}), head_channels=4, conditions=11
)
NEAR = {
    "gap_m": 2e-3, "base_thickness_m": 5e-3, "index_offset": 0.02, "dispersion_scale": 0.5, "is_point_source": 1.0,
    "lamp_distance_m": 0.25, "lamp_half_angle_rad": 0.0, "tilt_x_rad": 0.02, "tilt_y_rad": -0.01, "fresnel": 1.0,
}  # fmt: skip


def simulated(scene, heights):
    with torch.no_grad():
        return CausticSimulator(scene, "lattice")(torch.as_tensor(heights, dtype=torch.float32))


def told_weights(folder, scene, told_by="film"):
    """File of a told network with random weights, of the family."""
    torch.manual_seed(0)
    network = build(DirectConfig(backbone=BACKBONE, told_by=told_by), scene)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.normal_(std=0.1)
    path = folder / f"told-by-{told_by}.safetensors"
    training = {"family": family_of(scene, RANGES, 0.2)}
    save_weights(path, network, scene=scene, data_fingerprint=None, training=training)
    return str(path)


@pytest.fixture
def weights(tmp_path, scene):
    return told_weights(tmp_path, scene)


def test_any_bench_of_the_family_is_taken_and_others_are_refused(weights, scene, heights):
    bench = bench_scene(scene, **NEAR)
    image = CausticImage(simulated(bench, heights).numpy(), noise_std=np.full(3, 0.01))
    result = create("direct", bench, weights=weights, refine_iterations=2).reconstruct(image)
    assert result.heights_m.shape == (16, 16) and np.isfinite(result.heights_m).all()
    assert result.counters["symmetries"] == 8
    for changes, message in (
        ({"base_thickness_m": 8e-3}, r"base_thickness_m is 0.008 here, the nearest that is known is 0.0075"),
        ({"screen_position_m": (0.0, 0.0, -4e-3)}, r"gap_m is 0.004 here, the nearest that is known is 0.002001"),
        ({"light_tilt_rad": (0.05, 0.0)}, r"light's angle aside is 0.05004 here, .* 0.03001"),
        ({"emission_half_angle_rad": 0.5, "light_position_m": (0.0, 0.0, 0.1)}, r"0.097 m here, .* known is 0.25 m"),
        ({"glass": 1.7}, r"index of the glass at the middle wavelength is 1.7 here"),
        (
            {"wavelengths_m": (6e-7, 5.3e-7, 2.5e-7)},
            r"index at wavelength 2 less that at the middle one is 0.04665 here",
        ),
        ({"screen_position_m": (4e-3, 0.0, -1e-6)}, r"the window lies 8.0% of the plate beside its image"),
        ({"exit_medium": "glass"}, r"exit_medium is air there and glass here"),
    ):
        with pytest.raises(MismatchError, match=f"is for other benches: .*{message}.*; train one with: nsfc train"):
            create("direct", scene.model_copy(update=changes), weights=weights)


def test_the_family_holds_what_was_drawn_and_the_scene():
    from data_gen.benches.bench_set import Benches
    from data_gen.dataset_config import DatasetConfig

    scene = Scene(height_samples=16, image_pixels=64)
    dataset = DatasetConfig(kind="capture", n_samples=100, scene=scene, bench=RANGES)
    benches, family = Benches(dataset), family_of(scene, RANGES)
    for drawn in benches.scenes(benches.draw(range(60))):
        assert check_family(seen_scene(drawn, scene), scene, family, "network", "direct") == ()
    assert check_family(seen_scene(scene, scene), scene, family, "network", "direct") == ()
    assert family["divergence_1_m"] == [0.0, 4.0] and family["base_thickness_m"] == pytest.approx([1.5e-3, 7.5e-3])


def test_a_picture_of_a_flat_plate_is_flat(scene):
    bench = bench_scene(scene, **NEAR)
    flat = simulated(bench, torch.zeros(16, 16))
    seen = ToldBench(bench, scene, CPU).picture(flat)
    assert (flat - 1).abs().max() > 0.05 and (seen - 1)[:, 4:-4, 4:-4].abs().max() < 3e-3
    # Brighter by a fifth: told by all its light, as for even light.
    assert (ToldBench(bench, scene, CPU).picture(1.2 * flat) - seen).abs().max() < 3e-3
    image = torch.rand(3, 64, 64)
    assert ToldBench(scene, scene, CPU).picture(image) is image


@pytest.mark.parametrize("told_by", ["film", "maps", "picture"])
def test_what_is_told_turns_with_the_picture(tmp_path, scene, heights, told_by):
    """A turned plate on a turned bench gives the turned answer, whichever way the network is told."""
    weights = told_weights(tmp_path, scene, told_by)
    bench = bench_scene(scene, **NEAR)
    turned = bench_scene(scene, **{**NEAR, "tilt_x_rad": -0.02})
    image = simulated(bench, heights)
    mirror = all_symmetries(scene)[:, 1:2]
    other = transformed(image[None], mirror)[0]
    options = {"weights": weights, "refine": False, "causes": False}
    answers = [
        create("direct", where, **options).reconstruct(CausticImage(seen.numpy())).heights_m
        for where, seen in ((bench, image), (turned, other), (bench, other))
    ]
    size = np.abs(answers[0]).max()
    assert np.abs(answers[0][:, ::-1] - answers[1]).max() < 1e-3 * size
    # A wrong tilt moves the picture a little, each wavelength by its own.
    least = 1e-3 if told_by == "picture" else 1e-2
    assert np.abs(answers[0][:, ::-1] - answers[2]).max() > least * size


def test_noise_is_told_where_the_image_brings_it(scene):
    bench, places = ToldBench(scene, scene, CPU), all_symmetries(scene)
    told = bench.told(None, places)
    assert told.shape == (8, 22) and (told[:, 11:20] == 1).all() and (told[:, 20:] == 0).all()
    told = bench.told(0.02, places)
    assert (told[:, 21] == 1).all() and (told[:, 20] == 0).all() and told[0, 10] == pytest.approx(0.4)


def test_the_shipped_network_told_its_scene_answers_as_it_did(tmp_path):
    loaded = load_weights(FOLDER / "direct.safetensors")
    scene, plain = loaded.info.scene, loaded.info.architecture
    config = plain.model_copy(update={"backbone": plain.backbone.model_copy(update={"conditions": 11})})
    network = build(config, scene)
    network.load_state_dict(loaded.module.state_dict(), strict=False)
    path = tmp_path / "told.safetensors"
    training = {"family": family_of(scene, RANGES), "steps": 5000}
    save_weights(path, network, scene=scene, data_fingerprint=None, training=training)
    image = CausticImage(1 + 0.3 * np.random.default_rng(0).random((3, 512, 512)))
    options = {"refine": False, "symmetries": False, "causes": False}
    told = create("direct", scene, weights=str(path), **options).reconstruct(image)
    before = create("direct", scene, second_opinion=False, **options).reconstruct(image)
    assert np.abs(told.heights_m - before.heights_m).max() < 1e-6 * np.abs(before.heights_m).max()


def test_uncertainty_has_a_floor_where_answers_share_what_is_told():
    answers = torch.tensor([[[1.0, 3.0]], [[3.0, 3.0]]], dtype=torch.float64)
    plain = Calibration(scale=1.5, within_one=0.7, within_two=0.9, fields=1, seed=0)
    std = 2**0.5
    torch.testing.assert_close(uncertainty(answers, plain), torch.tensor([[1.5 * std, 0.0]], dtype=torch.float64))
    wanted = torch.tensor([[math.hypot(1.5 * std, 0.2), 0.2]], dtype=torch.float64)
    torch.testing.assert_close(uncertainty(answers, dataclasses.replace(plain, floor_m=0.4), scale=2.0), wanted)
    bowed = torch.tensor([[math.hypot(1.5 * std, 0.3), 0.3]], dtype=torch.float64)
    torch.testing.assert_close(uncertainty(answers, plain, flatness_m=0.3), bowed)
    assert uncertainty(answers[:1], plain, flatness_m=0.3) is None
    assert FAMILY_CALIBRATION.floor_m > 0 == DIRECT_CALIBRATION.floor_m


def test_numbers_of_a_scene_may_be_numpys(weights, scene, heights):
    bench = bench_scene(scene, **{name: np.float64(value) for name, value in NEAR.items()})
    image = CausticImage(simulated(bench, heights).numpy())
    result = create("direct", bench, weights=weights, refine=False).reconstruct(image)
    assert np.isfinite(result.heights_m).all()


def test_how_flat_the_base_is_may_be_said_as_of_any_other_number():
    options = DirectOptions(priors={"gap_m": 1e-5, "flatness_m": 2e-6})
    assert options.flatness_m == 2e-6 and options.priors == {"gap_m": 1e-5}
    assert DirectOptions(priors={"flatness_m": 0}).flatness_m == 0 and DirectOptions().flatness_m is None
    assert DirectOptions(**options.model_dump()) == options
    assert FibresOptions(priors={"flatness_m": 2e-6}).flatness_m == 2e-6
    assert options.flatness_beside == 0  # the bench's part has it
    alone = DirectOptions(flatness_m=2e-6, bench_uncertainty=False)
    assert alone.flatness_beside == 2e-6 and DirectOptions(flatness_m=0, bench_uncertainty=False).flatness_beside == 0
    # Nobody says how flat the base is: as flat as answers tell it.
    assert DirectOptions(bench_uncertainty=False).flatness_beside == BARE_M
    with pytest.raises(ValueError, match="flatness_m"):
        DirectOptions(priors={"flatness_m": -1})
