"""What lies in a data set's folder: names, the record beside each shard, and the list that says it is finished.

Records carry a hash of themselves and have one spelling only: a changed bit is
either seen at once or was never written.
"""

import hashlib
import importlib.metadata
import json
import math
import platform
import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from data_gen.sampler import Field
from warp_caustics.errors import DamagedDataError
from warp_caustics.io.regular import read_regular

FIELD_DTYPES = ("float16", "float32", "float64")
_HASH = re.compile(r"[0-9a-f]{64}")
FORMAT_VERSION = 1
"""Raised whenever an older reader would misread the files."""


@dataclass(frozen=True)
class Layout:
    """Paths of a data set.

    Attributes:
        root: the data set's folder.
    """

    root: Path

    @property
    def config(self) -> Path:
        """Canonical JSON whose sha256 is the data set's fingerprint; written first, never changed."""
        return self.root / "config.json"

    @property
    def complete(self) -> Path:
        """Written last; its presence means finished."""
        return self.root / "COMPLETE.json"

    @property
    def index(self) -> Path:
        """Virtual view of all shards, for people."""
        return self.root / "index.h5"

    @property
    def lock(self) -> Path:
        return self.root / ".lock"

    @property
    def shards(self) -> Path:
        return self.root / "shards"

    def shard(self, shard: int) -> Path:
        return self.shards / f"{shard:05d}.h5"

    def manifest(self, shard: int) -> Path:
        return self.shards / f"{shard:05d}.json"


def canonical_json(tree: Any) -> bytes:
    """One spelling per content, so that hashes of it mean something."""
    return json.dumps(tree, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()


def sha256(data: bytes | memoryview) -> str:
    """Hash in hexadecimal."""
    return hashlib.sha256(data).hexdigest()


@dataclass(frozen=True)
class Manifest:
    """What is in a shard.

    Attributes:
        shard: its number.
        n_bytes: size of the file.
        sha256: hash of the file.
        fingerprint: hash of the data set's configuration.
        ids: sample numbers in the order of the arrays.
        samples: field name to one hash per sample, see :func:`data_gen.store.shard.sample_digest`.
        counters: what the sampler counted, one number per sample.
        fields: the arrays of a sample.
        compression: ``"gzip"`` or ``"none"``.
        device: where it was made: ``"cpu"``, ``"cuda:0"``.
        code_version: of this package.
        libraries: versions of what shaped the bytes.
    """

    shard: int
    n_bytes: int
    sha256: str
    fingerprint: str
    ids: tuple[int, ...]
    samples: Mapping[str, tuple[str, ...]]
    counters: Mapping[str, tuple[float, ...]]
    fields: tuple[Field, ...]
    compression: str
    device: str
    code_version: str
    libraries: Mapping[str, str]

    def to_bytes(self) -> bytes:
        return _sealed({**asdict(self), "fields": [field.record() for field in self.fields]})

    @classmethod
    def from_bytes(cls, data: bytes) -> "Manifest":
        """Read a manifest.

        Raises:
            DamagedDataError: it is not exactly what :meth:`to_bytes` wrote.
        """
        tree = _unsealed(data, "manifest")
        try:
            manifest = cls(
                **{
                    **tree,
                    "ids": tuple(tree["ids"]),
                    "samples": {name: tuple(hashes) for name, hashes in tree["samples"].items()},
                    "counters": {name: tuple(numbers) for name, numbers in tree["counters"].items()},
                    "fields": tuple(Field.from_record(field) for field in tree["fields"]),
                }
            )
            _check_manifest(manifest)
        except (KeyError, TypeError, AttributeError, ValueError) as error:
            raise DamagedDataError(f"manifest has wrong entries ({str(error)[:80]})") from error
        return manifest


@dataclass(frozen=True)
class Entry:
    """A line of the list: a shard and its manifest."""

    shard: int
    n_bytes: int
    sha256: str
    manifest_sha256: str


@dataclass(frozen=True)
class Complete:
    """Content of COMPLETE.json.

    Attributes:
        fingerprint: hash of the configuration.
        n_samples: all of them.
        entries: one per shard, in order.
    """

    fingerprint: str
    n_samples: int
    entries: tuple[Entry, ...]

    def to_bytes(self) -> bytes:
        return _sealed(asdict(self))

    @classmethod
    def from_bytes(cls, data: bytes) -> "Complete":
        """Read COMPLETE.json.

        Raises:
            DamagedDataError: it is not exactly what :meth:`to_bytes` wrote.
        """
        tree = _unsealed(data, "COMPLETE.json")
        try:
            complete = cls(**{**tree, "entries": tuple(Entry(**entry) for entry in tree["entries"])})
            _check_complete(complete)
        except (KeyError, TypeError, ValueError) as error:
            raise DamagedDataError(f"COMPLETE.json has wrong entries ({str(error)[:80]})") from error
        return complete

    @classmethod
    def of(cls, fingerprint: str, manifests: Iterable[Manifest]) -> "Complete":
        entries, samples = [], 0
        for manifest in manifests:
            entries.append(Entry(manifest.shard, manifest.n_bytes, manifest.sha256, sha256(manifest.to_bytes())))
            samples += len(manifest.ids)
        return cls(fingerprint, samples, tuple(entries))


def _require(is_right: bool, what: str) -> None:
    if not is_right:
        raise ValueError(what)


def _is_count(value: object, least: int = 0) -> bool:
    return type(value) is int and least <= value < 2**63


def _is_hash(value: object) -> bool:
    return isinstance(value, str) and _HASH.fullmatch(value) is not None


def _check_manifest(manifest: Manifest) -> None:
    """Refuse entries of other types than are written: a seal tells who wrote last, not what."""
    _require(_is_count(manifest.shard) and _is_count(manifest.n_bytes), "shard or n_bytes")
    _require(_is_hash(manifest.sha256) and _is_hash(manifest.fingerprint), "sha256 or fingerprint")
    _require(all(map(_is_count, manifest.ids)), "ids")
    texts = (manifest.compression, manifest.device, manifest.code_version)
    _require(all(isinstance(text, str) for text in texts), "compression, device or code_version")
    _require(isinstance(manifest.libraries, Mapping), "libraries")
    _require(len(manifest.fields) > 0, "fields")
    for field in manifest.fields:
        words = (field.name, field.dtype, field.unit, field.description)
        _require(all(isinstance(word, str) for word in words) and field.dtype in FIELD_DTYPES, "fields")
        _require(all(_is_count(length, 1) for length in field.shape), f"shape of {field.name[:40]}")
        _require(len(field.columns) in (0, *field.shape[:1]), f"columns of {field.name[:40]}")
        names = [word for column in field.columns for word in (column.name, column.unit, column.description)]
        _require(all(isinstance(word, str) for word in names), f"columns of {field.name[:40]}")
        _require(len(manifest.samples[field.name]) == len(manifest.ids), f"samples of {field.name[:40]}")
    _require(all(_is_hash(digest) for digests in manifest.samples.values() for digest in digests), "samples")
    for numbers in manifest.counters.values():
        _require(len(numbers) == len(manifest.ids), "counters")
        _require(all(type(number) in (int, float) and math.isfinite(number) for number in numbers), "counters")


def _check_complete(complete: Complete) -> None:
    _require(_is_hash(complete.fingerprint) and _is_count(complete.n_samples), "fingerprint or n_samples")
    for number, entry in enumerate(complete.entries):
        _require(entry.shard == number and type(entry.shard) is int and _is_count(entry.n_bytes), f"entry {number}")
        _require(_is_hash(entry.sha256) and _is_hash(entry.manifest_sha256), f"entry {number}")


def read_manifest(path: Path) -> Manifest | None:
    """The manifest at a path, None where there is none.

    Raises:
        DamagedDataError: it is there and broken.
    """
    try:
        return Manifest.from_bytes(read_regular(path))
    except FileNotFoundError:
        return None
    except OSError as error:
        raise DamagedDataError(f"manifest {str(path)!r} cannot be read ({error.strerror})") from error


def read_complete(path: Path) -> Complete | None:
    """The list at a path, None where the data set is unfinished.

    Raises:
        DamagedDataError: it is there and broken.
    """
    try:
        return Complete.from_bytes(read_regular(path))
    except FileNotFoundError:
        return None
    except OSError as error:
        raise DamagedDataError(f"{str(path)!r} cannot be read ({error.strerror})") from error


def code_version() -> str:
    """Version of this package."""
    try:
        return importlib.metadata.version("nsfc")
    except importlib.metadata.PackageNotFoundError:
        return "unknown"


def library_versions() -> dict[str, str]:
    """Versions of what may change a shard's bytes without changing its arrays, and of what makes the arrays."""
    import zlib

    import h5py

    versions = {"python": platform.python_version(), "zlib": zlib.ZLIB_RUNTIME_VERSION}
    versions |= {"h5py": h5py.version.version, "hdf5": h5py.version.hdf5_version}
    for name in ("numpy", "torch", "warp-lang"):
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return versions


def _sealed(tree: dict[str, Any]) -> bytes:
    tree = {"format_version": FORMAT_VERSION, **tree}
    return canonical_json({**tree, "self_sha256": sha256(canonical_json(tree))})


def _unsealed(data: bytes, name: str) -> dict[str, Any]:
    try:
        tree = json.loads(data)
        # One spelling only, so that no change of a byte goes unnoticed.
        if not isinstance(tree, dict) or canonical_json(tree) != data:
            raise ValueError("not in canonical form")
    except (ValueError, RecursionError) as error:
        raise DamagedDataError(f"{name} is damaged ({str(error)[:80]})") from error
    seal = tree.pop("self_sha256", "")
    if seal != sha256(canonical_json(tree)):
        raise DamagedDataError(f"{name} is damaged (its content does not match its own hash)")
    version = tree.pop("format_version", None)
    if version != FORMAT_VERSION:
        raise DamagedDataError(f"{name} has format version {version!r}, this software reads {FORMAT_VERSION}")
    return tree
