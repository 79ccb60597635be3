"""Symmetries act on plate and image together; noise and exposure are what they say."""

import pytest
import torch

from data_gen.config import ReliefConfig
from data_gen.dataset_config import DatasetConfig
from data_gen.samples import Reliefs
from nets.training.augment import draw_symmetries, noisy, photographed, scene_symmetries, transformed
from nets.training.config import PhotonVariant
from nets.training.imaging import Imager
from nets.training.keys import step_generator
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator

CPU = torch.device("cpu")
SCENE = Scene(height_samples=16, image_pixels=64)
ALL = torch.tensor([[i & 1, i >> 1 & 1, i >> 2 & 1] for i in range(8)], dtype=torch.bool).T
FAR = SCENE.model_copy(update={"screen_position_m": (0.0, 0.0, -0.03)})


def reliefs(count=1):
    config = DatasetConfig(kind="updater", n_samples=100, scene=SCENE, reliefs=ReliefConfig())
    return Reliefs(config, "cpu").true(range(count))


@pytest.mark.parametrize("scene", [SCENE, FAR], ids=["near screen", "far screen"])
def test_the_caustic_of_a_turned_plate_is_the_turned_caustic(scene):
    # In float64: where a caustic folds, float32 rounds a photon's path by 1e-4 of the image.
    simulate = CausticSimulator(scene, n_photons=64**2, dtype=torch.float64)
    heights = reliefs().double().expand(8, -1, -1)
    expected = transformed(simulate(heights), ALL)
    errors = (simulate(transformed(heights, ALL)) - expected).abs().amax(dim=(1, 2, 3)) / expected.max()
    assert errors[:4].max() < 1e-5, "mirrored"
    # The splat takes the rows of a footprint one by one, so x and y are not quite the same to it.
    assert errors[4:].max() < (1e-3 if scene is SCENE else 0.06), "swapped"
    # They are eight different images, or nothing would be tested.
    distances = (expected[:, None] - expected[None]).abs().amax(dim=(2, 3, 4)) / expected.max()
    assert distances[~torch.eye(8, dtype=torch.bool)].min() > 0.1


def test_the_gradient_turns_with_the_heights():
    imager = Imager(SCENE, PhotonVariant(photons_per_pixel=1.0), CPU)
    target = imager(reliefs(2)[1:]).expand(8, -1, -1, -1)
    heights = reliefs().expand(8, -1, -1)
    _, straight = imager.with_gradient(heights, target)
    _, turned = imager.with_gradient(transformed(heights, ALL), transformed(target, ALL))
    assert (turned - transformed(straight, ALL)).abs().max() < 2e-3 * straight.abs().max()
    assert (turned - straight)[1:].abs().amax(dim=(1, 2)).min() > 0.1 * straight.abs().max()


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, (True, True, True)),
        ({"plate_size_m": (0.05, 0.04)}, (True, True, False)),
        ({"screen_position_m": (1e-3, 0.0, -0.01)}, (False, True, False)),
        ({"emission_half_angle_rad": 0.1}, (True, True, True)),
        ({"emission_half_angle_rad": 0.1, "light_position_m": (0.0, 0.1, 1.0)}, (True, False, False)),
    ],
)
def test_only_symmetries_of_the_scene_are_drawn(changes, expected):
    scene = Scene.model_validate({**SCENE.model_dump(), **changes})
    assert scene_symmetries(scene) == expected
    drawn = draw_symmetries(200, scene, step_generator(0, "symmetries", 0, 0, CPU))
    assert tuple(bool(row.any()) for row in drawn) == expected
    assert not drawn.all()


def test_augmentation_is_a_function_of_seed_and_step():
    images, flat = torch.ones(3, 3, 8, 8), torch.ones(3, 1, 1)

    def drawn(seed, step):
        return photographed(images, flat, 0.03, 0.05, step_generator(seed, "camera", step, 0, CPU))

    assert torch.equal(drawn(1, 5), drawn(1, 5))
    assert not torch.equal(drawn(1, 5), drawn(1, 6))
    assert not torch.equal(drawn(1, 5), drawn(2, 5))


def test_noise_and_exposure_have_the_stated_size():
    images, flat = torch.ones(400, 1, 32, 32), torch.ones(1, 1, 1)
    seen = photographed(images, flat, 0.03, 0.05, step_generator(0, "camera", 0, 0, CPU))
    brightness, level = seen.mean(dim=(1, 2, 3)), seen.std(dim=(1, 2, 3))
    assert 0.94 < brightness.min() < 0.96 and 1.04 < brightness.max() < 1.06
    assert level.max() < 0.033 and level.min() < 0.002 and abs(level.mean() - 0.015) < 0.003
    fixed = noisy(4 * images, flat, 0.01, step_generator(0, "noise", 0, 0, CPU))
    # Photon noise: twice as strong where it is four times as bright.
    assert abs(fixed.std() - 0.02) < 1e-3


def test_nothing_is_changed_when_all_is_off():
    images = torch.rand(2, 3, 8, 8)
    assert torch.equal(photographed(images, torch.ones(3, 1, 1), 0.0, 0.0, step_generator(0, "c", 0, 0, CPU)), images)
