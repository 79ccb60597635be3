"""A data set's configuration on disk: written first, compared on every later build, read by everybody else."""

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from data_gen.dataset_config import MAX_SAMPLES, DatasetConfig
from data_gen.store.layout import Complete, Layout, Manifest, canonical_json, code_version, read_complete, sha256
from warp_caustics.errors import DamagedDataError, InputError, MismatchError
from warp_caustics.io.atomic import PathLike
from warp_caustics.io.durable import make_folder, publish
from warp_caustics.io.regular import read_regular

_MOST_DIFFERENCES = 8


@dataclass(frozen=True)
class StoredConfig:
    """What config.json says.

    Attributes:
        tree: its content.
        fingerprint: its hash.
    """

    tree: dict[str, Any]
    fingerprint: str

    @property
    def n_samples(self) -> int:
        return int(self.tree["n_samples"])

    @property
    def samples_per_shard(self) -> int:
        return int(self.tree["samples_per_shard"])

    @property
    def n_shards(self) -> int:
        return -(-self.n_samples // self.samples_per_shard)

    def shard_ids(self, shard: int) -> range:
        """Sample ids of a shard, as :meth:`data_gen.dataset_config.DatasetConfig.shard_ids` says."""
        first = shard * self.samples_per_shard
        return range(first, min(first + self.samples_per_shard, self.n_samples))


def open_folder(directory: PathLike) -> tuple[Layout, StoredConfig]:
    """Layout and configuration of an existing data set, finished or not.

    Raises:
        InputError: there is none.
        DamagedDataError: config.json is broken.
    """
    layout = Layout(Path(directory))
    if not layout.root.is_dir():
        raise InputError(f"folder {str(layout.root)!r} does not exist; check the spelling")
    try:
        data = read_regular(layout.config)
    except FileNotFoundError:
        raise InputError(f"{str(layout.root)!r} is no data set, it has no config.json; check the spelling") from None
    except OSError as error:
        raise InputError(f"{str(layout.config)!r} cannot be read ({error.strerror})") from error
    tree = _parsed(data, layout)
    stored = StoredConfig(tree, sha256(canonical_json(tree)))
    try:
        counts = tree["n_samples"], tree["samples_per_shard"]
        if not all(type(count) is int and 0 < count <= MAX_SAMPLES for count in counts):
            raise ValueError(f"n_samples, samples_per_shard = {counts}")
    except (KeyError, ValueError) as error:
        raise DamagedDataError(f"{str(layout.config)!r} is damaged ({error}); restore it from a copy") from error
    return layout, stored


def prepare_folder(directory: PathLike, config: DatasetConfig) -> Layout:
    """Make the folder of a data set, or check that it holds this one. Call with the lock held.

    Raises:
        MismatchError: it holds another data set; names what differs.
    """
    layout = Layout(Path(directory))
    wanted = canonical_json(config.canonical())
    try:
        found = read_regular(layout.config)
    except FileNotFoundError:
        found = None
    if found is None:
        refuse_strangers(layout)
    elif found != wanted:
        differing = differences(_parsed(found, layout), config.canonical())
        if differing:
            raise MismatchError(_explained(layout, differing))
    if found != wanted:
        # The same content in another spelling, as after editing by hand, gets its canonical spelling back.
        publish(layout.config, wanted)
    make_folder(layout.shards)
    return layout


REPAIRED_BY_BUILD = "; build again to repair"
"""Ends the message of what the next build writes anew."""


def load_complete(layout: Layout, config: StoredConfig) -> Complete | None:
    """COMPLETE.json, None where the data set is unfinished.

    Raises:
        DamagedDataError: it is broken, belongs to another configuration, or does not list every shard and sample:
            one rule for whoever reads, checks or builds.
    """
    try:
        complete = read_complete(layout.complete)
    except DamagedDataError as error:
        raise DamagedDataError(f"{str(layout.root)!r}: {error}{REPAIRED_BY_BUILD}") from error
    if complete is not None and complete.fingerprint != config.fingerprint:
        raise DamagedDataError(
            f"{str(layout.root)!r}: config.json (fingerprint {config.fingerprint[:12]}) is not the one that "
            f"COMPLETE.json was written for ({complete.fingerprint[:12]}); restore it from a copy"
        )
    if complete is not None:
        found, wanted = (len(complete.entries), complete.n_samples), (config.n_shards, config.n_samples)
        if found != wanted:
            raise DamagedDataError(
                f"COMPLETE.json lists {found[0]} of {wanted[0]} shards and {found[1]} of {wanted[1]} samples"
                f"{REPAIRED_BY_BUILD}"
            )
    return complete


def present_shards(layout: Layout, config: StoredConfig) -> list[int]:
    """Numbers of the shards that have a file or a manifest: a folder is listed, not asked for millions of names."""
    if not layout.shards.is_dir():
        return []
    stems = {name.partition(".")[0] for name in os.listdir(layout.shards)}
    numbers = {int(stem) for stem in stems if stem.isascii() and stem.isdigit() and len(stem) <= 9}
    return sorted(number for number in numbers if number < config.n_shards)


def check_same_origin(manifest: Manifest, compression: str, fields: Any = None) -> None:
    """Refuse to continue a data set with other code than it was begun with.

    Raises:
        MismatchError: names what differs.
    """
    was = {"code version": manifest.code_version, "compression": manifest.compression}
    now = {"code version": code_version(), "compression": compression}
    if fields is not None:
        was["fields"], now["fields"] = (
            "; ".join(f"{f.name} {f.dtype} {list(f.shape)}" for f in part) for part in (manifest.fields, fields)
        )
    differing = [f"{key} {was[key]} -> {now[key]}" for key in was if was[key] != now[key]]
    if differing:
        raise MismatchError(
            f"the data set was begun with something else: {', '.join(differing)}; "
            "continue with that, or build into a new folder"
        )


def differences(old: Any, new: Any, key: str = "") -> list[str]:
    """Keys that differ, with both values. The order of keys does not matter, nor 1 or 1.0."""
    if isinstance(old, dict) and isinstance(new, dict):
        missing = object()
        return [
            line
            for name in sorted({*old, *new})
            for line in differences(old.get(name, missing), new.get(name, missing), f"{key}.{name}" if key else name)
        ]
    if isinstance(old, list | tuple) and isinstance(new, list | tuple) and len(old) == len(new):
        if all(not differences(a, b) for a, b in zip(old, new, strict=True)):
            return []
    elif old == new and isinstance(old, bool) == isinstance(new, bool):
        return []
    return [f"{key} {_value(old)} -> {_value(new)}"]


def _value(value: Any) -> str:
    if type(value) is object:
        return "absent"
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _explained(layout: Layout, differing: list[str]) -> str:
    more = len(differing) - _MOST_DIFFERENCES
    listed = ", ".join(differing[:_MOST_DIFFERENCES]) + (f" and {more} more" if more > 0 else "")
    why = ""
    if [line.split(" ")[0] for line in differing] == ["n_samples"]:
        why = " (the number of samples belongs to what a data set is; a longer one begins with the same samples)"
    return (
        f"{str(layout.root)!r} holds another data set: {listed}{why}; "
        "use its configuration to resume, or build into a new folder"
    )


def refuse_strangers(layout: Layout) -> None:
    """Refuse a folder that holds anything, but no data set.

    Raises:
        InputError: names what it holds.
    """
    if layout.config.is_file():
        if not {"n_samples", "samples_per_shard"} <= _parsed(read_regular(layout.config), layout).keys():
            raise InputError(f"{str(layout.config)!r} is no data set's; give an empty folder")
        return
    strangers = sorted(entry.name for entry in layout.root.iterdir() if not entry.name.startswith("."))
    if strangers:
        raise InputError(
            f"{str(layout.root)!r} holds {strangers[0]!r} but no config.json: no data set; give an empty folder"
        )


def _parsed(data: bytes, layout: Layout) -> dict[str, Any]:
    try:
        tree = json.loads(data)
        if not isinstance(tree, dict):
            raise ValueError("no object")
    except (ValueError, RecursionError) as error:
        raise DamagedDataError(
            f"{str(layout.config)!r} is damaged ({str(error)[:80]}); restore it from a copy"
        ) from error
    return tree
