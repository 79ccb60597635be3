"""Test fields: seen by photons of their own, and apart from each other and from everything that is trained on."""

import numpy as np
import torch

from data_gen.dataset_config import DatasetConfig, sample_seed
from data_gen.testset import COUNTS, TEST_PHOTONS, field_heights, field_images, fields_config
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator

DEVELOPMENT = "6589b5f86154139e3bae0b500ae54cf3ed25aa9040947cb9f66d87a7346f3f96"
TEST = "08a73e53dd75590eed15c70884bebddc3a4b92a42803cfed8bf71b66d6b5f2e2"


def flat_plate(placement, seed):
    """Image of a flat plate by as many photons per pixel as the test fields get, shape [3, 64, 64]."""
    scene = Scene(height_samples=16, image_pixels=64)
    per_pixel = TEST_PHOTONS.n_photons / Scene().image_pixels ** 2
    few = TEST_PHOTONS.model_copy(update={"n_photons": int(per_pixel * 64**2), **placement})
    image = CausticSimulator(scene, seed=seed, **few.record())(torch.zeros(16, 16)).numpy()
    return image[:, 4:-4, 4:-4]


def test_test_images_are_not_from_the_lattice_that_methods_use():
    """Their photons leave 1.8 % of noise on a flat plate, another with another seed; a lattice leaves none."""
    assert field_images.__kwdefaults__["photons"] is TEST_PHOTONS
    first, second = (flat_plate({}, seed) for seed in (1, 2))
    assert 0.015 < first.std() < 0.021
    assert abs(np.corrcoef(first.ravel(), second.ravel())[0, 1]) < 0.1
    assert flat_plate({"placement": "lattice", "preset": "lattice"}, 1).std() < 1e-3


SMALL = Scene(height_samples=16, image_pixels=64)


def test_test_fields_share_nothing_with_development_fields_nor_with_training():
    """By role and fingerprint: another set with any seed has other reliefs, photons and noise."""
    sets = {which: fields_config(which=which) for which in COUNTS}
    assert {which: config.n_samples for which, config in sets.items()} == {"development": 10, "test": 30}
    configs = [*sets.values(), *(config.model_copy(update={"role": "data"}) for config in sets.values())]
    fingerprints = [config.sample_fingerprint() for config in configs]
    assert len(set(fingerprints)) == 4
    keys = {sample_seed(f, kind, k) for f in fingerprints for kind in ("relief", "photons/test") for k in range(30)}
    assert len(keys) == 4 * 2 * 30
    assert all(config.role == "test" and DatasetConfig.model_validate(config.model_dump()) for config in sets.values())
    heights = np.concatenate([field_heights(SMALL, which=which) for which in sets]).reshape(40, -1)
    assert np.abs(np.corrcoef(heights) - np.eye(40)).max() < 0.9


def test_known_fingerprints_stay():
    """Stored results name them."""
    assert fields_config().sample_fingerprint() == DEVELOPMENT
    assert fields_config(which="test").sample_fingerprint() == TEST
