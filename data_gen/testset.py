"""The ten test fields: fixed, drawn from Tab. 3, and never part of any training data.

Their images come from a photon set that training and reconstruction never use
(sixteen million stratified photons, one per cell of a grid, jittered). They leave 1.8 % of noise on a flat plate;
1 % of white noise is added.
"""

import numpy as np
import numpy.typing as npt
import torch

from data_gen.dataset_config import DatasetConfig, PhotonConfig, sample_generator, sample_seed
from data_gen.samples import Reliefs
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator

TEST_FIELDS = 10
"""How many test fields there are."""
NOISE_STD = 0.01
"""Standard deviation of the noise, relative to the light through a flat plate."""

TEST_PHOTONS = PhotonConfig(n_photons=16_000_000, placement="stratified")


def fields_config(scene: Scene | None = None) -> DatasetConfig:
    """Configuration of the test fields; its role keeps them apart from every data set, whatever the seeds.

    Args:
        scene: the set-up; Tab. 1 if None. Another scene of the same plate shows the same plates.
    """
    return DatasetConfig(kind="updater", n_samples=TEST_FIELDS, seed=20231, role="test", scene=scene or Scene())


def field_heights(scene: Scene | None = None, device: str = "cpu") -> npt.NDArray[np.float32]:
    """True heights of the test fields [m], shape [10, n, n]."""
    reliefs = Reliefs(fields_config(scene), device, fields_config().sample_fingerprint())
    return reliefs.true(range(TEST_FIELDS)).cpu().numpy()


def field_images(
    scene: Scene | None = None,
    device: str = "cpu",
    *,
    noise_std: float = NOISE_STD,
    photons: PhotonConfig = TEST_PHOTONS,
    fields: int = TEST_FIELDS,
) -> npt.NDArray[np.float32]:
    """Images of the test fields [W/m^2], shape [fields, n_w, m, m].

    Args:
        scene: the set-up; Tab. 1 if None.
        device: where to simulate.
        noise_std: white noise, relative to the light through a flat plate; the same for every call.
        photons: how to simulate.
        fields: how many of the ten.
    """
    config = fields_config(scene)
    fingerprint = fields_config().sample_fingerprint()
    simulator = CausticSimulator(config.scene, device=device, **photons.model_dump())
    heights = torch.from_numpy(field_heights(scene, device)).to(simulator.device)
    flat = np.array(config.scene.radiosity_W_m2)[:, None, None]
    images = []
    for field, relief in enumerate(heights[:fields]):
        simulator.reseed(sample_seed(fingerprint, "photons/test", field))
        image = simulator(relief).cpu().numpy()
        noise = sample_generator(fingerprint, "noise", field).standard_normal(image.shape)
        # A camera does not count below zero.
        images.append(np.maximum(image + noise_std * flat * noise, 0.0).astype(np.float32))
    return np.stack(images)
