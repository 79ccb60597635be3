"""Fields to judge methods by: fixed, drawn from Tab. 3, and never part of any training data.

Ten *development fields*, on which methods were compared while they were written (docs/learned.md says what was tuned
on them), and thirty *test fields* that nothing was tuned on: their scores are computed once for a release
(``benchmarks.release``) and looked at by nobody before.

Their images come from a photon set that training and reconstruction never use
(sixteen million stratified photons, one per cell of a grid, jittered). They leave 1.8 % of noise on a flat plate;
1 % of white noise is added.
"""

from collections.abc import Callable
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt
import torch

from data_gen.dataset_config import DatasetConfig, PhotonConfig, sample_generator, sample_seed
from data_gen.samples import Reliefs
from warp_caustics.errors import InputError
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator

FieldSet = Literal["development", "test"]

DEVELOPMENT_FIELDS = 10
"""How many development fields there are."""
TEST_FIELDS = 30
"""How many test fields there are."""
COUNTS: dict[FieldSet, int] = {"development": DEVELOPMENT_FIELDS, "test": TEST_FIELDS}
_SEEDS: dict[FieldSet, int] = {"development": 20231, "test": 20_261_122}
NOISE_STD = 0.01
"""Standard deviation of the noise, relative to the light through a flat plate."""

TEST_PHOTONS = PhotonConfig(n_photons=16_000_000, placement="stratified")


def fields_config(scene: Scene | None = None, which: FieldSet = "development") -> DatasetConfig:
    """Configuration of a set of fields; its role keeps it apart from every data set, whatever the seeds.

    Args:
        scene: the set-up; Tab. 1 if None. Another scene of the same plate shows the same plates.
        which: the set.
    """
    return DatasetConfig(
        kind="updater", n_samples=COUNTS[which], seed=_SEEDS[which], role="test", scene=scene or Scene()
    )


def field_count(which: FieldSet, wished: int | None = None) -> int:
    """How many fields of a set: all if None.

    Raises:
        InputError: no such set, or more than it has.
    """
    if which not in COUNTS:
        raise InputError(f"no set of fields {which!r}; there are {', '.join(get_args(FieldSet))}")
    count = COUNTS[which] if wished is None else wished
    if not 1 <= count <= COUNTS[which]:
        raise InputError(f"{count} {which} fields; there are {COUNTS[which]}, give 1 to {COUNTS[which]}")
    return count


def field_heights(
    scene: Scene | None = None, device: str = "cpu", which: FieldSet = "development"
) -> npt.NDArray[np.float32]:
    """True heights of a set of fields [m], shape [fields, n, n]."""
    reliefs = Reliefs(fields_config(scene, which), device, fields_config(which=which).sample_fingerprint())
    return reliefs.true(range(COUNTS[which])).cpu().numpy()


def field_images(
    scene: Scene | None = None,
    device: str = "cpu",
    *,
    noise_std: float = NOISE_STD,
    photons: PhotonConfig = TEST_PHOTONS,
    fields: int | None = None,
    which: FieldSet = "development",
    told: Callable[[int, int], None] | None = None,
) -> npt.NDArray[np.float32]:
    """Images of a set of fields [W/m^2], shape [fields, n_w, m, m].

    Args:
        scene: the set-up; Tab. 1 if None.
        device: where to simulate.
        noise_std: white noise, relative to the light through a flat plate; the same for every call.
        photons: how to simulate.
        fields: how many, the first ones; all if None.
        which: the set.
        told: called with the number of images done and of all, before each and after the last.

    Raises:
        InputError: more fields than there are.
    """
    told = told or (lambda done, total: None)
    count = field_count(which, fields)
    config = fields_config(scene, which)
    fingerprint = fields_config(which=which).sample_fingerprint()
    simulator = CausticSimulator(config.scene, device=device, **photons.record())
    heights = torch.from_numpy(field_heights(scene, device, which)).to(simulator.device)
    flat = np.array(config.scene.radiosity_W_m2)[:, None, None]
    images = []
    for field, relief in enumerate(heights[:count]):
        told(field, count)
        simulator.reseed(sample_seed(fingerprint, "photons/test", field))
        image = simulator(relief).cpu().numpy()
        noise = sample_generator(fingerprint, "noise", field).standard_normal(image.shape)
        # A camera does not count below zero.
        images.append(np.maximum(image + noise_std * flat * noise, 0.0).astype(np.float32))
    told(count, count)
    return np.stack(images)
