"""The networks that come with the software."""

import numpy as np
import pytest
import torch

from data_gen.dataset_config import DatasetConfig
from data_gen.samples import Reliefs
from nets.reconstruct.methods import create
from nets.reconstruct.uncertainty import DIRECT
from nets.shipped import shipped_weights
from nets.weights import load_weights
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator


def test_files_are_sound_and_small():
    files = shipped_weights()
    assert "direct.safetensors" in [file.name for file in files]
    assert all(file.stat().st_size <= 16e6 for file in files)
    assert sum(file.stat().st_size for file in files) <= 40e6
    for file in files:
        assert load_weights(file).info.content_hash


def test_calibration_was_measured():
    assert DIRECT.fields >= 16 and 0.5 < DIRECT.scale < 2
    assert DIRECT.within_one == pytest.approx(0.683, abs=0.02) and 0.88 < DIRECT.within_two < 0.98


def test_direct_recovers_a_printed_field():
    """A field of Tab. 3 that was never trained on, seen by other photons and with 1 % of noise, at full size."""
    scene = Scene()
    config = DatasetConfig(kind="updater", n_samples=2, seed=424_242)
    truth = Reliefs(config, "cpu").true([1])
    simulator = CausticSimulator(scene, n_photons=1_500_000, placement="stratified", smoothing=5.0, seed=7)
    noise = torch.randn(3, 512, 512, generator=torch.Generator().manual_seed(7)).numpy()
    image = CausticImage(np.maximum(simulator(truth[0]).numpy() + 0.01 * noise, 0))
    result = create("direct", scene, refine=False).reconstruct(image)
    error = result.heights_m - truth[0].numpy()
    flat = float(truth.square().mean().sqrt())
    rmse = float(np.sqrt((error**2).mean()))
    assert flat > 4e-4
    assert rmse < 8e-5
    within = (np.abs(error) <= result.uncertainty_m).mean(), (np.abs(error) <= 2 * result.uncertainty_m).mean()
    assert 0.4 < within[0] < 0.95 and within[1] > 0.7
