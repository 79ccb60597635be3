"""Cameras of the training: nothing changes where nothing is off, and each effect is what it says."""

import numpy as np
import pytest
import torch

from data_gen.dataset_config import DatasetConfig
from data_gen.samples import Reliefs
from nets.training.camera import Camera, draw_cameras, noisy, seen
from nets.training.config import CameraConfig
from nets.training.imaging import Imager
from nets.training.keys import step_generator
from nets.unrolling_config import PhotonVariant
from warp_caustics.scene import Scene

SCENE = Scene(height_samples=16, image_pixels=64)
CPU = torch.device("cpu")
FLAT = torch.ones(3, 1, 1)
NONE = {name: 0.0 for name in CameraConfig.model_fields}
COUNT = 4000


def rng(seed=0, purpose="camera"):
    return step_generator(seed, purpose, 0, 0, CPU)


def caustics(count=2):
    config = DatasetConfig(kind="updater", n_samples=100, scene=SCENE)
    return Imager(SCENE, PhotonVariant(), CPU)(Reliefs(config, "cpu").true(range(count)))


def test_a_camera_without_effects_changes_nothing():
    images = caustics()
    cameras = draw_cameras(CameraConfig(**NONE), 2, 3, rng())
    # The splines' filter is cut at 1e-6, along both axes.
    assert (seen(images, FLAT, cameras, rng()) - images).abs().max() < 5e-6 * images.max()


def test_each_range_is_reached_and_kept():
    config = CameraConfig()
    cameras = draw_cameras(config, COUNT, 3, rng())
    distance = cameras.shift.norm(dim=2)
    for values, largest in (
        (distance, config.shift_px),
        (cameras.scale.abs(), config.scale),
        (cameras.blur, config.blur_px),
        (cameras.ambient, config.ambient),
        (cameras.light.abs().amax(dim=2), config.unevenness),
        (cameras.noise, config.noise),
        (cameras.correlation, config.correlation),
    ):
        assert 0.9 * largest < values.max() <= largest * (1 + 1e-6)
    assert not cameras.shift[:, 1].any() and not cameras.scale[:, 1].any(), "the middle channel keeps its place"
    angle = torch.atan2(cameras.shift[:, 0, 1], cameras.shift[:, 0, 0])[distance[:, 0] > 0]
    assert all((angle.div(np.pi / 4).floor() == octant).float().mean() > 0.1 for octant in range(-4, 4))
    # Red and blue go their own ways.
    assert abs(np.corrcoef(cameras.shift[:, 0, 0], cameras.shift[:, 2, 0])[0, 1]) < 0.05
    assert (cameras.power.min() < 0.02) and (cameras.power.max() > 0.98)


def test_a_third_is_nearly_clean():
    config = CameraConfig()
    cameras = draw_cameras(config, COUNT, 3, rng())
    clean = cameras.blur.sum(dim=1) == 0
    assert abs(clean.float().mean() - 1 / 3) < 0.03
    assert not cameras.shift[clean].any() and not cameras.ambient[clean].any() and not cameras.light[clean].any()
    off = cameras.mixing[clean] - torch.diag_embed(torch.diagonal(cameras.mixing[clean], dim1=1, dim2=2))
    assert not off.any()
    assert cameras.noise[clean].max() <= config.clean_noise


def test_the_same_step_sees_the_same_camera():
    images = caustics()

    def once(seed):
        generator = rng(seed)
        return seen(images, FLAT, draw_cameras(CameraConfig(), 2, 3, generator), generator)

    assert torch.equal(once(1), once(1)) and not torch.equal(once(1), once(2))


@pytest.mark.parametrize("power", [0.0, 0.5, 1.0])
def test_noise_grows_with_the_signal_as_it_says(power):
    count = 64
    cameras = draw_cameras(CameraConfig(**NONE), count, 1, rng())._replace(
        noise=torch.full((count,), 0.05), power=torch.full((count,), power), correlation=torch.full((count,), 0.4)
    )
    for level in (0.25, 4.0):
        images = torch.full((count, 1, 32, 32), level)
        noise = seen(images, FLAT[:1], cameras, rng()) - images
        assert float(noise.std()) == pytest.approx(0.05 * level**power, rel=0.02)
    neighbour = (noise * noise.roll(1, -1)).mean() / noise.square().mean()
    assert float(neighbour) == pytest.approx(0.4 / (1 + 2 * 0.4**2), rel=0.05)


def test_mixing_keeps_grey_and_blends_colours():
    mixing = torch.tensor([[[0.95, 0.05, 0.0], [0.0, 1.0, 0.0], [0.0, 0.1, 0.9]]])
    plain = draw_cameras(CameraConfig(**NONE), 1, 3, rng())
    images = torch.tensor([1.0, 2.0, 3.0])[None, :, None, None].expand(1, 3, 8, 8)
    found = seen(images, FLAT, plain._replace(mixing=mixing), rng())[0, :, 4, 4]
    assert torch.allclose(found, torch.tensor([0.95 + 0.1, 2.0, 0.2 + 2.7]), atol=1e-6)


def test_photon_noise_of_the_validation():
    """Twice as strong where it is four times as bright."""
    fixed = noisy(4 * torch.ones(400, 1, 32, 32), torch.ones(1, 1, 1), 0.01, rng(0, "noise"))
    assert abs(fixed.std() - 0.02) < 1e-3


def test_ranges_that_make_no_camera_are_refused():
    with pytest.raises(ValueError, match="blur_px"):
        CameraConfig(blur_px=3.0)
    assert isinstance(draw_cameras(CameraConfig(), 1, 1, rng()), Camera), "one wavelength has no other to be apart from"
