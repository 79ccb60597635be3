"""Sensors of a batch: the model of single photos, with noise that a photo's key alone decides."""

import numpy as np
import pytest
import torch

from warp_caustics.camera.config import SensorConfig
from warp_caustics.camera.exposure import exposed
from warp_caustics.camera.sensors import SensorLimits, Sensors, electrons_of, exposed_batch, keys_of

SIDE = 96


def sensors(count=1, seeds=None, **values):
    """Exposure, full well, read noise, frames, black level, steps, contrast, grains, fresh ones, hot pixels."""
    names = ("exposure", "full", "read", "frames", "black", "steps", "contrast", "grains", "fresh", "hot")
    usual = {"exposure": 0.04, "frames": 16, "steps": 65535}
    numbers = torch.tensor([[float({**usual, **values}.get(name, 0)) for name in names]] * count)
    keys = torch.from_numpy(keys_of(np.array(seeds or [7 + k for k in range(count)], dtype=np.float64)))
    return Sensors(numbers, torch.full((count,), float(values.get("width", 1.0))), keys)


def flat(count=1, level=1.0):
    return torch.full((count, 3, SIDE, SIDE), level)


def test_without_noise_photos_are_light_in_steps():
    light = torch.linspace(0, 30, 3 * SIDE * SIDE).reshape(1, 3, SIDE, SIDE)
    found = exposed_batch(light, None, 2.0, sensors(black=0.02, steps=1023), SensorLimits())
    config = SensorConfig(exposure=0.04, black_level=0.02, bits=10)
    wanted = exposed(light[0], config, 2.0, torch.Generator())
    # Rounding to the nearest may differ where light lies between two steps.
    assert (found.photo[0] - wanted).abs().max() < 1.01 / 1023
    assert ((found.photo[0] - wanted).abs() < 1e-6).float().mean() > 0.999
    assert found.dark.numel() == 0 and float(found.photo.max()) <= 1


@pytest.mark.parametrize("read_share", [0.0, 0.5])
def test_noise_is_what_was_asked_for(read_share):
    """Mean to five standard errors, variance to 5 %; frames average it; the same as of single photos."""
    noise = 0.02
    full, read = (float(v[0]) for v in electrons_of(*(np.array([v]) for v in (noise, read_share, 0.04))))
    found = exposed_batch(flat(2), flat(2), 1.0, sensors(2, full=full, read=read, black=0.1), SensorLimits())
    photo = (found.photo - 0.1) / 0.04
    assert abs(float(photo.mean()) - 1) < 5 * noise / photo.numel() ** 0.5 + 1e-5
    assert float(photo.std()) == pytest.approx(noise, rel=0.05)
    assert float(found.flat.std() / 0.04) == pytest.approx(noise / 4, rel=0.05)
    single = SensorConfig(full_well_electrons=full, read_noise_electrons=read, exposure=0.04, black_level=0.1)
    other = exposed(flat()[0], single, 1.0, torch.Generator().manual_seed(1))
    assert float(other.std()) == pytest.approx(float(found.photo.std()), rel=0.03)
    # Photos and channels are independent.
    pairs = (photo[0, 0], photo[1, 0]), (photo[0, 0], photo[0, 1])
    for a, b in pairs:
        assert abs(float(torch.corrcoef(torch.stack([a.flatten(), b.flatten()]))[0, 1])) < 5 / SIDE


def test_a_photo_follows_from_its_key():
    options = {"full": 3e4, "read": 5, "contrast": 0.05, "grains": 3, "fresh": 2, "hot": 30}
    limits = SensorLimits(largest_speckle_px=1.0, most_grains=5)
    together = exposed_batch(flat(3), flat(3), 1.0, sensors(3, seeds=[2**51 + 5, 8, 9], **options), limits)
    alone = exposed_batch(flat(1), flat(1), 1.0, sensors(1, seeds=[2**51 + 5], **options), limits)
    for a, b in zip(together, alone, strict=True):
        assert torch.equal(a[:1], b)
    assert not torch.equal(together.photo[0], together.photo[1])


def test_speckle_has_its_contrast_and_width():
    found = exposed_batch(
        flat(4), flat(4), 1.0, sensors(4, contrast=0.2, width=1.5), SensorLimits(largest_speckle_px=2.0)
    )
    factor = found.photo / 0.04
    assert float(factor.mean()) == pytest.approx(1, abs=0.01) and float(factor.std()) == pytest.approx(0.2, rel=0.05)
    logarithm = torch.log(factor) - torch.log(factor).mean()
    apart = (logarithm[..., 2:] * logarithm[..., :-2]).mean() / logarithm.square().mean()
    assert float(apart) == pytest.approx(np.exp(-4 / (4 * 1.5**2)), abs=0.04)
    between = torch.corrcoef(torch.stack([factor.flatten(), found.flat.flatten()]))[0, 1]
    assert abs(float(between)) < 0.05, "the flat frame has speckle of its own"


def test_dust_is_in_photo_and_flat_frame_and_fresh_dust_in_the_photo_alone():
    limits = SensorLimits(most_grains=20, dust_radius_px=(3, 4), dust_depth=(0.5, 0.5))
    old = exposed_batch(flat(), flat(), 1.0, sensors(grains=20), limits)
    assert torch.allclose(old.photo, old.flat, atol=2e-5) and float(old.photo.min()) < 0.022
    dark = float((old.photo < 0.039).float().mean())
    assert dark == pytest.approx(20 * np.pi * 3.5**2 / SIDE**2, rel=0.4)
    fresh = exposed_batch(flat(), flat(), 1.0, sensors(fresh=20), limits)
    assert torch.equal(fresh.photo, old.photo), "the same grains"
    assert float(fresh.flat.min()) > 0.0399


def test_hot_pixels_are_the_same_in_all_frames():
    limits = SensorLimits(hot_level=(0.2, 0.5))
    found = exposed_batch(flat(), flat(), 1.0, sensors(hot=60), limits)
    is_hot = found.dark > 0.1
    assert 35 < int(is_hot.sum()) < 90
    assert torch.equal(is_hot, found.photo > 0.15) and torch.equal(is_hot, found.flat > 0.15)
    assert float(found.dark[is_hot].min()) >= 0.2 - 1e-4 and float(found.dark[is_hot].max()) <= 0.5 + 1e-4
