"""Symmetries act on plate and image together; averaging over all of them."""

import pytest
import torch

from data_gen.config import ReliefConfig
from data_gen.dataset_config import DatasetConfig
from data_gen.samples import Reliefs
from nets.symmetries import all_symmetries, draw_symmetries, scene_symmetries, seen_in, transformed, turned_back
from nets.training.imaging import Imager
from nets.training.keys import step_generator
from nets.unrolling_config import PhotonVariant
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator

CPU = torch.device("cpu")
SCENE = Scene(height_samples=16, image_pixels=64)
ALL = torch.tensor([[i & 1, i >> 1 & 1, i >> 2 & 1] for i in range(8)], dtype=torch.bool).T
MAPS = torch.rand(3, 6, 6, generator=torch.Generator().manual_seed(1))
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


@pytest.mark.parametrize(
    ("changes", "count"),
    [
        ({}, 8),
        ({"plate_size_m": (0.05, 0.04)}, 4),
        ({"screen_position_m": (1e-3, 0.0, -1e-6)}, 2),
        ({"screen_position_m": (1e-3, 1e-3, -1e-6)}, 1),
        ({"emission_half_angle_rad": 0.1, "light_position_m": (0.0, 0.01, 1.0)}, 2),
    ],
)
def test_only_symmetries_that_the_scene_has(changes, count):
    symmetries = all_symmetries(Scene(**changes))
    assert symmetries.shape == (3, count)
    assert not symmetries[:, 0].any()
    assert len({tuple(column) for column in symmetries.T.tolist()}) == count


def test_all_eight_differ_and_turn_back():
    symmetries = all_symmetries(Scene())
    seen = seen_in(MAPS, symmetries)
    assert all(not torch.equal(seen[a], seen[b]) for a in range(8) for b in range(a))
    assert torch.equal(turned_back(seen, symmetries), MAPS.expand(8, -1, -1, -1))


def test_mean_of_an_equivariant_network_is_its_answer():
    """A 3 x 3 mean commutes with turns and flips; a shift by one does not, and its mean differs."""
    symmetries = all_symmetries(Scene())

    def blurred(x):
        return torch.nn.functional.avg_pool2d(x, 3, 1, 1)

    def shifted(x):
        return x.roll(1, dims=-1)

    for network, is_equal in ((blurred, True), (shifted, False)):
        mean = turned_back(network(seen_in(MAPS, symmetries)), symmetries).mean(0)
        assert torch.allclose(mean, network(MAPS[None])[0], atol=1e-6) == is_equal
