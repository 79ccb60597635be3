"""What is compared on: true reliefs, and for each the one image that every method gets.

Images of height maps are simulated with photons that no method uses: stratified, sixteen million
(``data_gen.testset``), and white noise is added to that of the photons. They are kept on disk, because sums on a GPU
depend on the order of threads, and another image would be another comparison.
"""

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch

from data_gen.dataset_config import PhotonConfig, sample_generator, sample_seed
from data_gen.testset import FieldSet, field_count, field_heights, fields_config
from nets.evaluation.arrays import array_hash, read_arrays, write_arrays
from nets.evaluation.code_version import code_version
from warp_caustics.capture.read import read_capture
from warp_caustics.errors import InputError
from warp_caustics.fold_fraction import fold_fraction
from warp_caustics.io.noise import estimate_noise_std
from warp_caustics.prints.relief_file import read_relief
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator
from warp_caustics.types import FloatArray


@dataclass(frozen=True, eq=False)
class Field:
    """A plate to be recovered.

    Attributes:
        name: short and unique.
        heights_m: the truth [m], shape [n, n].
        image: what every method gets.
        folds: share of the plate where light paths have crossed.
        origin: ``simulated``, or ``file`` of an image that was given.
        warnings: what reading the image had to say.
    """

    name: str
    heights_m: FloatArray
    image: CausticImage
    folds: float
    origin: str
    warnings: tuple[str, ...] = ()

    def content(self) -> dict[str, str | None]:
        """Hashes of all that a method may see, and of the truth."""
        image = self.image
        arrays = {"heights": self.heights_m, "image": image.irradiance, "noise": image.noise_std, "mask": image.mask}
        return {name: None if array is None else array_hash(array) for name, array in arrays.items()}


@dataclass(frozen=True, eq=False)
class Source:
    """A field before its image exists.

    Attributes:
        name: short and unique.
        heights_m: the truth [m], shape [n, n].
        keys: fingerprint and number that select photons and noise.
        given: the image, if it came from a file.
        warnings: what reading it had to say.
    """

    name: str
    heights_m: FloatArray
    keys: tuple[str, int] = ("", 0)
    given: CausticImage | None = field(default=None)
    warnings: tuple[str, ...] = ()


def testset_sources(
    scene: Scene, device: str, count: int | None = None, which: FieldSet = "development"
) -> list[Source]:
    """Development or test fields, or the first few; the same plates and images as ``nsfc data testset`` writes.

    Raises:
        InputError: no such number of fields.
    """
    count = field_count(which, count)
    fingerprint = fields_config(which=which).sample_fingerprint()
    heights = field_heights(scene, device, which)[:count].astype(np.float64)
    return [Source(f"field_{k}", relief, (fingerprint, k)) for k, relief in enumerate(heights)]


testset_sources.__test__ = False  # type: ignore[attr-defined]


def file_sources(texts: Sequence[str], scene: Scene) -> list[Source]:
    """Height maps, and pairs HEIGHTS:IMAGE, from files; all are read and checked before anything is computed.

    Raises:
        InputError: unreadable, all dark, or two of the same name.
        MismatchError: heights or image do not fit the scene.
    """
    sources = []
    for text in texts:
        heights, image = _split(text)
        sources.append(_simulated_source(heights, scene) if image is None else _paired_source(heights, image, scene))
    for source in sources:
        if sum(other.name == source.name for other in sources) > 1:
            raise InputError(f"two fields are called {source.name!r}; rename one of the files")
    return sources


def prepare(sources: Sequence[Source], scene: Scene, photons: PhotonConfig, noise: float, folder: Path, device: str,
            told: Callable[[int, int], None] | None = None) -> list[Field]:  # fmt: skip
    """Fields with their images; what is already in the folder is not simulated again.

    Args:
        sources: what to prepare.
        scene: the set-up.
        photons: how to simulate.
        noise: standard deviation, relative to the light through a flat plate.
        folder: where images are kept.
        device: where to simulate.
        told: called with the number of fields done and of all.
    """
    simulator: CausticSimulator | None = None
    fields: list[Field] = []
    for source in sources:
        if told is not None:
            told(len(fields), len(sources))
        if source.given is not None:
            folds = fold_fraction(source.heights_m, scene)
            fields.append(Field(source.name, source.heights_m, source.given, folds, "file", source.warnings))
            continue
        path = folder / f"{_image_key(source, scene, photons, noise)}.npz"
        arrays = read_arrays(path, ("image", "folds"))
        if arrays is None:
            simulator = simulator or CausticSimulator(scene, device=device, **photons.record())
            arrays = _simulated(source, simulator, noise)
            write_arrays(path, arrays)
        image = CausticImage(arrays["image"], _noise_std(arrays["image"], scene))
        folds = float(arrays["folds"])
        fields.append(Field(source.name, source.heights_m, image, folds, "simulated"))
    return fields


def _split(text: str) -> tuple[str, str | None]:
    """Both paths of HEIGHTS:IMAGE; a file whose name holds a colon is itself."""
    if ":" not in text or Path(text).exists():
        return text, None
    heights, _, image = text.rpartition(":")
    if not heights or not image:
        raise InputError(f"field {text!r} is not HEIGHTS or HEIGHTS:IMAGE; give both paths")
    return heights, image


def _simulated_source(path: str, scene: Scene) -> Source:
    heights = read_relief(path, scene.height_samples, scene.plate_size_m, "field")
    return Source(Path(path).stem, heights, (array_hash(heights), 0))


def _paired_source(heights: str, image: str, scene: Scene) -> Source:
    capture = read_capture(image, scene)
    relief = read_relief(heights, scene.height_samples, scene.plate_size_m, "reference")
    return Source(Path(heights).stem, relief, (array_hash(relief), 0), capture.caustic, capture.warnings)


def _image_key(source: Source, scene: Scene, photons: PhotonConfig, noise: float) -> str:
    content = {
        "heights": array_hash(source.heights_m),
        "keys": source.keys,
        "scene": scene.record(),
        "photons": photons.record(),
        "noise": noise,
        "code": code_version(),
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:32]


def _simulated(source: Source, simulator: CausticSimulator, noise: float) -> dict[str, Any]:
    """Noisy image [W/m^2], float32, shape [n_w, m, m], by the rule of the test set; and the fold fraction."""
    fingerprint, number = source.keys
    scene = simulator.scene
    simulator.reseed(sample_seed(fingerprint, "photons/test", number))
    heights = torch.from_numpy(source.heights_m.astype(np.float32)).to(simulator.device)
    with torch.no_grad():
        clean = simulator(heights).cpu().numpy()
    flat = np.array(scene.radiosity_W_m2)[:, None, None]
    drawn = sample_generator(fingerprint, "noise", number).standard_normal(clean.shape)
    # A camera does not count below zero.
    image = np.maximum(clean + noise * flat * drawn, 0.0).astype(np.float32)
    return {"image": image, "folds": np.array(fold_fraction(source.heights_m, scene))}


def _noise_std(image: FloatArray, scene: Scene) -> FloatArray | None:
    """Noise as ``nsfc reconstruct`` finds it, from the image alone [W/m^2], shape [n_w]; None if it cannot tell."""
    valid = np.ones(image.shape[1:], bool)
    found = np.array(
        [
            estimate_noise_std(signal.astype(np.float64), level, valid)
            for signal, level in zip(image, scene.radiosity_W_m2, strict=True)
        ]
    )
    return found if bool(np.isfinite(found).all()) else None
