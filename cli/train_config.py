"""Configuration of ``nsfc train``: defaults of the kind and preset, file, --set, options; later ones win."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cli.config import Config, TrainingWish, validated, with_settings
from cli.config_sections import merged, refuse_null_sections
from cli.shipped_files import config_path
from cli.spelled import spelled_in
from nets.training.config import RunConfig, TrainingKind, default_run
from warp_caustics.determinism import make_deterministic
from warp_caustics.errors import InputError
from warp_caustics.io.yaml_file import read_yaml
from warp_caustics.presets import PRESETS

if TYPE_CHECKING:
    from os import PathLike

RESOLVED = "config.resolved.yaml"


def new_run(
    kind: TrainingKind,
    preset: str | None,
    source: str | None,
    settings: Sequence[str],
    overrides: Mapping[str, Any],
) -> RunConfig:
    """The configuration of a new run.

    Args:
        kind: what is trained.
        preset: name of the network's preset; the kind's first if None.
        source: file or name of a configuration. One for the whole program gives scene, reliefs, for denoiser and
            updater Tab. 2's numbers, and whether results repeat; the rest of it is for other commands.
        settings: ``key.key=value``.
        overrides: dotted key to value, from other options; None is left out. A data set given here
            brings its scene and reliefs.

    Raises:
        InputError: unreadable, unknown keys, or values out of range.
    """
    tree = default_run(kind, preset)
    sources: list[tuple[str, dict[str, Any]]] = []
    if overrides.get("data") is not None:
        from data_gen.store import CausticDataset
        from nets.training.files import described

        stored = described(CausticDataset(overrides["data"])).model_dump(mode="json")
        tree = {**tree, "scene": stored["scene"], "reliefs": stored["reliefs"]}
    if source is not None:
        path = config_path(source)
        written = read_yaml(path)
        # In the configuration of a run `data` is a folder, and null is fresh samples.
        sections = Config().model_dump(mode="json") | {"network": tree["network"]}
        refuse_null_sections({k: v for k, v in written.items() if (k, v) != ("data", None)}, sections, f"{path}: ")
        simulation = written.get("simulation")
        make_deterministic(isinstance(simulation, dict) and simulation.get("deterministic") is True)
        written = _of_training(written, kind)
        tree = merged(tree, written, f"{path}: ")
        sources.append((str(path), written))
    return _checked(tree, settings, overrides, sources)


def resumed_run(folder: "str | PathLike[str]", settings: Sequence[str], overrides: Mapping[str, Any]) -> RunConfig:
    """The configuration of an earlier run, with changes; arguments as of :func:`new_run`."""
    path = Path(folder, RESOLVED)
    if not path.is_file():
        raise InputError(f"{str(folder)!r} holds no {RESOLVED}, so no run to resume; leave out --resume")
    tree = read_yaml(path)
    return _checked(tree, settings, overrides, [(str(path), tree)])


def _of_training(tree: dict[str, Any], kind: str) -> dict[str, Any]:
    """A configuration file for the whole program as one for training."""
    result = {key: value for key, value in tree.items() if key not in ("simulation", "reconstruction", "data")}
    wishes, photons = result.get("training"), tree.get("data")
    if kind in ("denoiser", "updater") and isinstance(photons, dict):
        # A run reads a data set's name there; a configuration for the whole program says how fresh images are made.
        wishes = {
            **_wished({name: _said_once(photons[name]) for name in ("noisy", "clean") if name in photons}),
            **(wishes or {}),
        }
    if isinstance(wishes, dict):
        result["training"] = _wished(wishes)
    numbers = {name: result.pop(name, None) for name in ("denoiser", "updater")}.get(kind)
    if numbers:
        result["network"] = {**(result.get("network") or {}), "network": numbers}
        rates = {key: numbers[key] for key in ("learning_rate", "lambda_tv") if numbers.get(key) is not None}
        result["training"] = {**rates, **(result.get("training") or {})}
    return result


def _said_once(photons: Any) -> Any:
    """Without what the preset says as well: spelled out or not, a run is the same."""
    if not isinstance(photons, dict):
        return photons
    preset = PRESETS.get(str(photons.get("preset")))
    same = {"smoothing", "placement"} if preset is not None else set()
    return {k: v for k, v in photons.items() if k not in same or v != getattr(preset, k)}


def _wished(tree: Mapping[str, Any]) -> dict[str, Any]:
    """Without the values that a configuration for the whole program leaves to the kind of training: null."""
    sections = {"validation", "noisy", "clean"}
    values = set(TrainingWish.model_fields) - sections
    result = {key: value for key, value in tree.items() if value is not None or key not in values}
    for name in sections & set(result):
        if isinstance(result[name], dict):
            result[name] = {key: value for key, value in result[name].items() if value is not None}
    return result


def _checked(
    tree: dict[str, Any],
    settings: Sequence[str],
    overrides: Mapping[str, Any],
    sources: list[tuple[str, dict[str, Any]]],
) -> RunConfig:
    tree = with_settings(tree, settings, overrides, sources)
    return validated(RunConfig, tree, spelled_in(sources, overrides))
