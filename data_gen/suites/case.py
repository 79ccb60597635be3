"""One case of a suite: a plate on a bench as it is, and the scene that methods are told."""

import hashlib
import json
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from data_gen.config import PatternConfig
from data_gen.dataset_config import DatasetConfig, PhotonConfig, sample_generator
from data_gen.suites.conditions import Condition
from data_gen.testset import TEST_PHOTONS
from warp_caustics.camera.config import CameraConfig
from warp_caustics.scene import Scene

SHARP_PHOTONS = PhotonConfig(n_photons=144_000_000)
"""Of cases with a sensor, whose noise is the camera's own: a lattice of 550 paths per pixel, of which methods use 4.

With 9 million the picture of fifteen lines was off by 57 standard deviations of its noise, all pixels together, which
takes heights 0.7 um along what one photo hardly tells of a bench; with 36 million by 14. That falls as the paths grow
in number, to about 4 here.
"""


def bench_plates(suite_seed: int, count: int, reliefs: PatternConfig, scene: Scene | None = None) -> DatasetConfig:
    """Plates of a suite; their role keeps them apart from every data set and from the test fields, whatever the seeds.

    Args:
        suite_seed: of the suite.
        count: how many.
        reliefs: what is printed.
        scene: gives plate and samples; Tab. 1 if None.
    """
    return DatasetConfig(
        kind="updater", n_samples=count, seed=suite_seed, role="bench", reliefs=reliefs, scene=scene or Scene()
    )


@dataclass(frozen=True)
class Plate:
    """A print by number.

    Attributes:
        config: of all prints of its kind.
        number: which of them.
        bow_m: how much higher the base is at the middle of a side than at the centre [m], besides what is printed.
    """

    config: DatasetConfig
    number: int
    bow_m: float = 0.0

    @cached_property
    def fingerprint(self) -> str:
        """Selects strokes, photons and noise."""
        return self.config.sample_fingerprint()

    def rng(self, purpose: str) -> np.random.Generator:
        """Random numbers of one purpose of this plate."""
        return sample_generator(self.fingerprint, purpose, self.number)


@dataclass(frozen=True)
class Case:
    """A plate on a bench.

    Attributes:
        suite: it belongs to.
        row: what differs from what is told, as a name for files; of all plates under the same bench.
        title: the same for people.
        plate: what was printed.
        told: scene that methods are told.
        scene: scene as it is.
        condition: what measures, where there is no camera; of a case with a camera only ``relief``.
        camera: takes a photo with dark and flat frame; None gives irradiance.
        photons: of the image.
    """

    suite: str
    row: str
    title: str
    plate: Plate
    told: Scene
    scene: Scene
    condition: Condition = field(default_factory=Condition)
    camera: CameraConfig | None = None
    photons: PhotonConfig = TEST_PHOTONS

    @property
    def name(self) -> str:
        """Of its files; unique in its suite."""
        return f"{self.row}_{self.plate.number}"

    @property
    def is_bench_exact(self) -> bool:
        """Whether the bench is exactly as told, which methods are told too; of one with a camera nobody says so.

        A picture that is moved or too large as a whole is a bench other than told.
        """
        return self.camera is None and self.scene == self.told and not self.condition.is_displaced

    def record(self) -> dict[str, Any]:
        """Everything that decides truth and image, as JSON values."""
        # Images through a lens that acted on pixels are others.
        lens = {} if self.camera is None else {"lens": "before the pixels"}
        return lens | {
            "suite": self.suite,
            "row": self.row,
            "title": self.title,
            "plates": self.plate.config.canonical(),
            "plate": self.plate.number,
            "bow_m": self.plate.bow_m,
            "told": self.told.record(),
            "scene": self.scene.record(),
            "condition": asdict(self.condition),
            "camera": None if self.camera is None else self.camera.model_dump(mode="json"),
            "photons": self.photons.record(),
        }

    def key(self) -> str:
        """Hash of the record."""
        return hashlib.sha256(json.dumps(self.record(), sort_keys=True).encode()).hexdigest()[:32]
