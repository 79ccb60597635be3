"""Configuration files: YAML in, one validated and immutable record out.

Read by the rules of :mod:`warp_caustics.io.yaml_file`. A key that is not known
is refused with a guess at the one that was meant.
"""

import difflib
import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, TypeVar

import pydantic
import yaml
from pydantic import AfterValidator, BaseModel, Field

from cli.spelled import spelled_in
from data_gen.bench_ranges import BenchRanges
from data_gen.config import PATTERN_CONFIGS, PatternConfig, ReliefConfig
from data_gen.dataset_config import DatasetConfig, PhotonConfig
from data_gen.making import Making
from data_gen.variety import PrintVariety
from nets.config import BEST_DENOISER, BEST_UPDATER, NetworkConfig
from warp_caustics.determinism import is_deterministic, make_deterministic
from warp_caustics.errors import InputError, known_names, shortened
from warp_caustics.io.atomic import regular_file
from warp_caustics.io.yaml_file import parsed_yaml, read_yaml
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


def dump_config(config: BaseModel) -> str:
    """A whole configuration as YAML, in a fixed order; :func:`load_config` reads it back unchanged."""
    tree = config.model_dump(mode="json")
    text: str = yaml.dump(tree, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=120)
    return text


def config_folder() -> Path:
    """Folder of the configurations that come with the software."""
    here = Path(__file__).parent
    # Inside the package when installed from a wheel, beside it in a checkout.
    return next((f for f in (here / "configs", here.parent / "configs") if f.is_dir()), here)


def shipped_configs() -> dict[str, Path]:
    """Configurations that come with the software, by name."""
    return {path.stem: path for path in sorted(config_folder().glob("*.yaml"))}


def config_path(source: str) -> Path:
    """File of a --config value: a bare name means a shipped configuration, anything else a path."""
    if "/" in source or "." in source:
        return regular_file(source)
    shipped = shipped_configs()
    if source not in shipped:
        guess = _guess(source, shipped) or f"use one of {', '.join(shipped)}, or a file such as ./{source}.yaml"
        raise InputError(f"configuration {source!r} is not shipped; {guess}")
    return shipped[source]


def shipped_benches() -> dict[str, Path]:
    """Ranges of benches that come with the software, by name."""
    return {path.stem: path for path in sorted((config_folder() / "benches").glob("*.yaml"))}


def bench_path(source: str) -> Path:
    """File of a --bench value: a bare name means shipped ranges, anything else a path."""
    if "/" in source or "." in source:
        return regular_file(source)
    shipped = shipped_benches()
    if source not in shipped:
        raise InputError(
            f"bench {source!r} is not shipped; {known_names(source, shipped)}, or give a file such as ./{source}.yaml"
        )
    return shipped[source]


def config_files(source: str | None) -> list[Path]:
    """The file of a --config value, where it is one of the user's."""
    return [] if source is None or source in shipped_configs() else [config_path(source)]


# --------------------------------------------------------------------------- YAML


class _Dumper(yaml.SafeDumper):
    """Lists on one line, everything else one key per line."""


_Dumper.add_representer(
    list, lambda dumper, data: dumper.represent_sequence("tag:yaml.org,2002:seq", data, flow_style=True)
)


def parsed_setting(setting: str) -> dict[str, Any]:
    """A --set value as nested sections: ``a.b=1`` is ``{"a": {"b": 1}}``."""
    key, equals, value = setting.partition("=")
    parts = key.strip().split(".")
    if not equals or not all(parts):
        raise InputError(
            f"--set {shortened(setting)!r} is not KEY=VALUE; write for example --set scene.image_pixels=256"
        )
    return nested(parts, parsed_yaml(value, f"--set {shortened(setting)}"))


# --------------------------------------------------------------------------- merging


def nested(parts: Sequence[str], value: Any) -> dict[str, Any]:
    """A value below sections of these names."""
    for part in reversed(parts):
        value = {part: value}
    nested: dict[str, Any] = value
    return nested


def _training_camera() -> Strict:
    from nets.training.config import CameraConfig  # brings torch

    return CameraConfig()


_MAY_BE_OFF: dict[str, Callable[[], Strict]] = {
    "reliefs.variety": PrintVariety,
    "reliefs.making": Making,
    "data.bench": BenchRanges,
    "training.bench": BenchRanges,
    "training.camera": _training_camera,
}
"""Sections that null switches off; no other can be off, so null there is refused."""


def merged(base: dict[str, Any], over: dict[str, Any], source: str, at: str = "") -> dict[str, Any]:
    """Values of ``over`` in place of those of ``base``, section by section; other keys than base's are refused."""
    if at == "reliefs." and over.get("pattern", base["pattern"]) != base["pattern"]:
        base = _pattern_defaults(over["pattern"], source)
    result = dict(base)
    # Options belong to a method, which alone knows their names.
    is_open = at.startswith("reconstruction.options.")
    for key, value in over.items():
        optional = _MAY_BE_OFF.get(f"{at}{key}") if key in base else None
        if optional is not None and value is None:
            result[key] = None
            continue
        if optional is not None and base[key] is None and isinstance(value, dict):
            # A section that is off is switched on by any of its keys.
            base = {**base, key: optional().model_dump(mode="json")}
        if key not in base and not is_open:
            guess = _guess(str(key), base) or f"known are {', '.join(base)}"
            raise InputError(f"{source}{at}{shortened(str(key))}: unknown key; {guess}")
        if not isinstance(base.get(key), dict):
            if isinstance(value, dict) and not is_open:
                raise InputError(f"{source}{at}{key} has no keys of its own; give its value")
            result[key] = value
        elif isinstance(value, dict):
            result[key] = merged(base[key], value, source, f"{at}{key}.")
        elif is_open:
            result[key] = value
        elif value is None:
            raise InputError(_null_section(f"{at}{key}", base[key], source))
        else:
            raise InputError(f"{source}{at}{key} is a section; give keys below it, got {shortened(repr(value))}")
    return result


def refuse_null_sections(tree: Mapping[str, Any], base: Mapping[str, Any], source: str, at: str = "") -> None:
    """Refuse null where ``base`` has a section that cannot be off; for trees that are changed before they are merged.

    Raises:
        InputError: such a section; what else may be wrong is left to :func:`merged`.
    """
    for key, value in tree.items():
        section = base.get(key)
        if not isinstance(section, dict) or f"{at}{key}" in _MAY_BE_OFF:
            continue
        if value is None:
            raise InputError(_null_section(f"{at}{key}", section, source))
        if isinstance(value, dict):
            refuse_null_sections(value, section, source, f"{at}{key}.")


def _null_section(name: str, section: Mapping[str, Any], source: str) -> str:
    example = next(iter(section), None)
    keys = "give {} for none" if example is None else f"give keys below it, as {name}.{example}"
    return (
        f"{source}{name} is null; of sections only {', '.join(_MAY_BE_OFF)} can be off: leave it out for its defaults, "
        f"or {keys}"
    )


def _pattern_defaults(name: Any, source: str) -> dict[str, Any]:
    """Another print pattern has other keys."""
    if not isinstance(name, str) or name not in PATTERN_CONFIGS:
        raise InputError(
            f"{source}reliefs.pattern {shortened(repr(name))} is not known; {known_names(str(name), PATTERN_CONFIGS)}"
        )
    return PATTERN_CONFIGS[name]().model_dump(mode="json")


def _guess(word: str, known: Mapping[str, Any]) -> str:
    close = difflib.get_close_matches(word, known, n=1)
    return f"did you mean {close[0]!r}?" if close else ""
