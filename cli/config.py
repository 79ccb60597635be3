"""Configuration files: YAML in, one validated and immutable record out.

Read by the rules of :mod:`warp_caustics.io.yaml_file`. A key that is not known
is refused with a guess at the one that was meant.
"""

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, TypeVar

import pydantic
import yaml
from pydantic import AfterValidator, BaseModel, Field

from cli.config_sections import merged, nested, parsed_setting
from cli.shipped_files import config_path
from cli.spelled import spelled_in
from data_gen.bench_ranges import BenchRanges
from data_gen.config import PatternConfig, ReliefConfig
from data_gen.dataset_config import DatasetConfig, PhotonConfig
from nets.config import BEST_DENOISER, BEST_UPDATER, NetworkConfig
from warp_caustics.determinism import is_deterministic, make_deterministic
from warp_caustics.errors import InputError, known_names, shortened
from warp_caustics.io.yaml_file import read_yaml
from warp_caustics.presets import PRESETS
from warp_caustics.scene import Placement, Profile, Scene, validation_lines
from warp_caustics.strict import Strict

Model = TypeVar("Model", bound=BaseModel)

MAX_PROBLEMS = 3
"""Problems named in one message."""


def _check_preset(value: str) -> str:
    if value not in PRESETS:
        raise ValueError(f"preset {shortened(value)!r} is not known; {known_names(value, PRESETS)}")
    return value


class SimulationConfig(Strict):
    """How ``nsfc simulate`` simulates; None takes the preset's value. Methods choose their own photons."""

    preset: Annotated[str, AfterValidator(_check_preset)] = "lattice"
    """Photon set: lattice (sharp, without noise) or paper (random, s = 16)."""
    n_photons: Annotated[int, Field(ge=1)] | None = None
    """n_l: light paths per wavelength."""
    smoothing: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = None
    """s: scales the photon footprint."""
    placement: Placement | None = None
    """Where photons start."""
    profile: Profile | None = None
    """Shape of a photon's footprint."""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    """Selects the set of random photons; no effect on a lattice."""
    deterministic: bool = False
    """Results on a GPU are the same to the last bit every time; of all commands, as --deterministic."""


class ReconstructionConfig(Strict):
    """Which method, with which options; the method checks its options itself."""

    method: str = "auto"
    """Name of the method; auto chooses by looking at the image."""
    options: dict[str, Any] = Field(default_factory=dict)
    """Settings of the method, by name."""


class PhotonWish(Strict):
    """What is known of how to simulate; None takes what suits the kind of data set."""

    preset: Annotated[str, AfterValidator(_check_preset)] | None = None
    """Photon set: lattice or paper."""
    n_photons: Annotated[int, Field(ge=1, le=10**9)] | None = None
    """n_l: light paths per wavelength."""
    smoothing: Annotated[float, Field(ge=0, le=1e4, allow_inf_nan=False)] | None = None
    """s: scales the photon footprint."""
    placement: Placement | None = None
    """Where photons start."""
    traced: Annotated[int, Field(ge=2, le=10**9)] | None = None
    """Paths traced in place of n_l random ones, with the same mean and noise; None traces all."""


class DataConfig(Strict):
    """How ``nsfc data build`` simulates."""

    samples_per_shard: Annotated[int, Field(ge=1, le=4096)] = 32
    """Samples in one file, the unit of work."""
    noisy: PhotonWish = PhotonWish()
    """The denoiser's input, and the updater's simulated image."""
    clean: PhotonWish = PhotonWish()
    """The denoiser's target, the updater's target image, and the light of captures."""
    bench: BenchRanges | None = None
    """Ranges from which each capture draws its bench; null where there are no captures."""


class ValidationWish(Strict):
    """What is known of the samples that a network is judged by; None takes what suits the kind of training."""

    count: Annotated[int, Field(ge=1, le=4096)] | None = None
    """Number of fixed samples."""


class TrainingWish(Strict):
    """What is known of a training; None takes what suits its kind. ``nsfc train`` takes all keys of a run here."""

    total_steps: Annotated[int, Field(ge=1, le=10**9)] | None = None
    """Length of the whole run in steps."""
    steps_per_epoch: Annotated[int, Field(ge=1, le=10**9)] | None = None
    """Steps between validations."""
    batch_size: Annotated[int, Field(ge=1, le=4096)] | None = None
    """Samples per step."""
    validation: ValidationWish = ValidationWish()


class Config(Strict):
    """Everything that can be set: Tab. 1 (scene, simulation), Tab. 2 (denoiser, updater) and Tab. 3 (reliefs)."""

    scene: Scene = Scene()
    simulation: SimulationConfig = SimulationConfig()
    reconstruction: ReconstructionConfig = ReconstructionConfig()
    reliefs: PatternConfig = ReliefConfig()
    data: DataConfig = DataConfig()
    denoiser: NetworkConfig = BEST_DENOISER
    updater: NetworkConfig = BEST_UPDATER
    training: TrainingWish = TrainingWish()

    def fingerprint(self) -> str:
        """Hash that changes with any value, and with nothing else."""
        tree = self.model_dump(mode="json") | {"scene": self.scene.record()}
        # Configurations from before these were there keep their hash where they are off.
        for section, key in (("reliefs", "making"), ("data", "bench"), ("simulation", "deterministic")):
            if not tree[section][key]:
                del tree[section][key]
        return hashlib.sha256(json.dumps(tree, sort_keys=True).encode()).hexdigest()


def dataset_config(config: Config, **values: Any) -> DatasetConfig:
    """The data set that a configuration describes.

    Args:
        config: gives scene, reliefs and data.
        values: kind, n_samples, seed and what else belongs to one data set.

    Raises:
        InputError: parts that do not fit together, such as a bench that its scene cannot have.
    """
    tree: dict[str, Any] = {
        "scene": config.scene,
        "reliefs": config.reliefs,
        "samples_per_shard": config.data.samples_per_shard,
        "bench": config.data.bench,
    }
    plain = validated(DatasetConfig, {**tree, **values})
    for name in ("noisy", "clean"):
        wish = {key: value for key, value in getattr(config.data, name).model_dump().items() if value is not None}
        tree[name] = PhotonConfig(**{**getattr(plain, name).model_dump(), **wish})
    return validated(DatasetConfig, {**tree, **values})


def load_config(
    source: str | None = None,
    settings: Sequence[str] = (),
    overrides: Mapping[str, Any] | None = None,
    *,
    also: Sequence[Path] = (),
    bench: str | None = None,
) -> Config:
    """The configuration of one run; later sources win. Where it asks for results that repeat, the process does them.

    Args:
        source: file, or name of a shipped configuration; defaults only if None.
        settings: ``key.key=value`` as given to --set, values in YAML.
        overrides: dotted key to value, from other options; None is left out.
        also: more files, read after the first.
        bench: bench.yaml of a calibration, whose scene comes after the files; None is none.

    Raises:
        InputError: unreadable, unknown keys, or values out of range.
    """
    tree: dict[str, Any] = Config().model_dump(mode="json")
    sources = [(str(path), read_yaml(path)) for path in [*([] if source is None else [config_path(source)]), *also]]
    if bench is not None:
        from warp_caustics.calibration.bench_file import read_bench

        sources.append((bench, {"scene": read_bench(bench).scene}))
    for name, written in sources:
        tree = merged(tree, written, f"{name}: ")
    asked = {"simulation.deterministic": is_deterministic() or None}
    tree = with_settings(tree, settings, {**(overrides or {}), **asked}, sources)
    config = validated(Config, tree, spelled_in(sources, overrides))
    make_deterministic(config.simulation.deterministic)
    return config


def with_settings(
    tree: dict[str, Any],
    settings: Sequence[str],
    overrides: Mapping[str, Any],
    sources: list[tuple[str, dict[str, Any]]],
) -> dict[str, Any]:
    """A configuration with what --set and other options say; the former are noted among its sources."""
    for setting in settings:
        parsed = parsed_setting(setting)
        tree = merged(tree, parsed, f"--set {shortened(setting)}: ")
        sources.append(("", parsed))
    for key, value in overrides.items():
        if value is not None:
            tree = merged(tree, nested(key.split("."), value), "")
    return tree


def validated(kind: type[Model], tree: Mapping[str, Any], spelled: Callable[[str], str] = str) -> Model:
    """A record of that kind; ``spelled`` says what a dotted key is called where it was written.

    Raises:
        InputError: unknown keys or values out of range, the first few of them.
    """
    try:
        return kind.model_validate(dict(tree))
    except pydantic.ValidationError as error:
        problems = validation_lines(error, spelled=spelled)
        more = f"; {len(problems) - MAX_PROBLEMS} more problems" if len(problems) > MAX_PROBLEMS else ""
        raise InputError("; ".join(problems[:MAX_PROBLEMS]) + more) from error


class _Dumper(yaml.SafeDumper):
    """Lists on one line, everything else one key per line."""


_Dumper.add_representer(
    list, lambda dumper, data: dumper.represent_sequence("tag:yaml.org,2002:seq", data, flow_style=True)
)


def dump_config(config: BaseModel) -> str:
    """A whole configuration as YAML, in a fixed order; :func:`load_config` reads it back unchanged."""
    tree = config.model_dump(mode="json")
    text: str = yaml.dump(tree, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=120)
    return text
