"""Batches in which every relief has a bench of its own: the same images as of simulators made one by one."""

import pytest
import torch

from warp_caustics.errors import InputError
from warp_caustics.many_scenes import ManyScenes
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator

BENCHES = (
    {},
    {"base_thickness_m": 3.05e-3, "index_offset": 0.001},
    {"lamp_half_angle_rad": 0.01, "fresnel": True, "screen_position_m": (1e-4, -2e-4, -2e-4)},
    {"light_tilt_rad": (0.004, -0.003), "lamp_half_angle_rad": 0.004},
    {"emission_half_angle_rad": 0.1, "light_position_m": (0.002, 0.0, 0.6), "lamp_radius_m": 1e-3},
)


def scenes():
    return [Scene(height_samples=24, image_pixels=32, **bench) for bench in BENCHES]


def reliefs(dtype=torch.float32):
    generator = torch.Generator().manual_seed(3)
    return 2e-4 * torch.rand(len(BENCHES), 24, 24, generator=generator).to(dtype)


@pytest.mark.parametrize("placement", ["lattice", "random"])
def test_each_image_is_that_of_a_simulator_of_its_own(placement):
    options = {"n_photons": 4096, "placement": placement}
    together = ManyScenes(scenes()[0], **options)(reliefs(), scenes())
    for scene, height, image in zip(scenes(), reliefs(), together, strict=True):
        assert torch.equal(CausticSimulator(scene, **options)(height), image)
    differences = (together[1:] - together[:1]).abs().amax(dim=(1, 2, 3))
    assert (differences > 1e-3).all(), "benches that differ show it"


def test_seeds_select_the_photons_of_each_relief():
    options = {"n_photons": 4096, "placement": "random"}
    together = ManyScenes(scenes()[0], **options)(reliefs(), scenes(), [11, 12, 13, 14, 15])
    alone = CausticSimulator(scenes()[3], seed=14, **options)(reliefs()[3])
    assert torch.equal(together[3], alone)


def test_an_engine_of_another_bench_leaves_the_first_as_it_was():
    simulator = CausticSimulator(scenes()[0], n_photons=4096, dtype=torch.float64)
    height = reliefs(torch.float64)[0]
    before = simulator(height)
    other = simulator.engine.on([scenes()[3]])
    other.image(height[None])
    assert torch.equal(simulator(height), before)
    assert other.scene is not simulator.engine.scene


def test_another_plate_is_refused():
    many = ManyScenes(scenes()[0], n_photons=256)
    with pytest.raises(InputError, match=r"image_pixels 64, the others 32.*set scene.image_pixels to 32"):
        many(reliefs()[:1], [Scene(height_samples=24, image_pixels=64)])
    with pytest.raises(InputError, match="2 scenes for 1 reliefs"):
        many(reliefs()[:1], scenes()[:2])


ALL_EFFECTS = {"fresnel": True, "second_hits": "lost"}
PAIRS = {
    "straight": ({}, {"base_thickness_m": 3.3e-3, "index_offset": 0.01, "screen_position_m": (1e-4, -2e-4, -2e-3)}),
    "straight, all effects": (
        ALL_EFFECTS | {"lamp_half_angle_rad": 0.01},
        ALL_EFFECTS | {"lamp_half_angle_rad": 0.03, "base_thickness_m": 3.3e-3, "dispersion_scale": 0.5},
    ),
    "tilted, all effects": (
        ALL_EFFECTS | {"lamp_half_angle_rad": 0.02, "light_tilt_rad": (0.04, -0.03)},
        ALL_EFFECTS | {"lamp_half_angle_rad": 0.01, "light_tilt_rad": (-0.2, 0.1), "index_offset": -0.02},
    ),
    "point, all effects": tuple(
        ALL_EFFECTS | {"emission_half_angle_rad": 0.6, "light_position_m": position, "lamp_radius_m": radius}
        for position, radius in (((0.002, 0.0, 0.1), 1e-3), ((-0.01, 0.03, 0.2), 3e-3))
    ),
}
"""Two benches with the same effects."""


@pytest.mark.parametrize("names", [[name] for name in PAIRS] + [list(PAIRS)], ids=[*PAIRS, "all mixed"])
@pytest.mark.parametrize("placement", ["lattice", "random"])
def test_one_launch_for_many_is_a_launch_for_each(names, placement):
    several = [Scene(height_samples=24, image_pixels=32, **PAIRS[name][k]) for k in range(2) for name in names]
    generator = torch.Generator().manual_seed(4)
    heights = 1e-3 * torch.rand(len(several), 24, 24, generator=generator, dtype=torch.float64)
    # Kernels of test_gradient.py, where there is one for each way of light already.
    profile = "spline" if placement == "lattice" else "gaussian"
    many = ManyScenes(several[0], n_photons=4096, placement=placement, profile=profile, dtype=torch.float64)
    one_by_one = many(heights, several)
    many.at_once = True
    assert len(many._launches(several, True)) == len(names)
    at_once = many(heights, several)
    assert (at_once - one_by_one).abs().max() < 1e-10 * one_by_one.abs().max()
    assert (at_once[: len(names)] - at_once[len(names) :]).abs().amax(dim=(1, 2, 3)).min() > 1e-2
