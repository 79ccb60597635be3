"""Test fields: seen by photons of their own, and apart from each other and from everything that is trained on."""

import numpy as np
import torch

from data_gen.testset import TEST_PHOTONS, field_images
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator


def flat_plate(placement, seed):
    """Image of a flat plate by as many photons per pixel as the test fields get, shape [3, 64, 64]."""
    scene = Scene(height_samples=16, image_pixels=64)
    per_pixel = TEST_PHOTONS.n_photons / Scene().image_pixels**2
    few = TEST_PHOTONS.model_copy(update={"n_photons": int(per_pixel * 64**2), **placement})
    image = CausticSimulator(scene, seed=seed, **few.model_dump())(torch.zeros(16, 16)).numpy()
    return image[:, 4:-4, 4:-4]


def test_test_images_are_not_from_the_lattice_that_methods_use():
    """Their photons leave 1.8 % of noise on a flat plate, another with another seed; a lattice leaves none."""
    assert field_images.__kwdefaults__["photons"] is TEST_PHOTONS
    first, second = (flat_plate({}, seed) for seed in (1, 2))
    assert 0.015 < first.std() < 0.021
    assert abs(np.corrcoef(first.ravel(), second.ravel())[0, 1]) < 0.1
    assert flat_plate({"placement": "lattice", "preset": "lattice"}, 1).std() < 1e-3
