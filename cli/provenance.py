"""Where a result comes from: files, configuration, software, time."""

import importlib.metadata
import os
import platform
import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from warp_caustics.errors import InputError

if TYPE_CHECKING:
    from cli.config import Config
    from warp_caustics.io.atomic import PathLike

PACKAGES = ("nsfc", "warp-lang", "torch", "numpy", "scipy", "pydantic", "tifffile", "imagecodecs", "h5py")


def provenance(config: "Config") -> dict[str, Any]:
    """Configuration, software and time, for a record that is written now."""
    return {"config_fingerprint": config.fingerprint(), "versions": versions(), "created": now()}


def now() -> str:
    """The local time as records have it."""
    return time.strftime("%Y-%m-%dT%H:%M:%S%z")


def versions() -> dict[str, str]:
    """Version of Python and of each package that shapes a result."""
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = "not installed"
    return found


def file_records(files: Mapping[str, str]) -> dict[str, dict[str, str]]:
    """Path and sha256 of each file, by its role."""
    return {kind: {"path": path, "sha256": file_sha256(path)} for kind, path in files.items()}


def file_sha256(path: "PathLike") -> str:
    """Hash of a file's content, hexadecimal.

    Raises:
        InputError: unreadable.
    """
    from warp_caustics.io import hashes
    from warp_caustics.io.atomic import reason

    try:
        return hashes.file_sha256(path)
    except OSError as error:
        raise InputError(f"{os.fspath(path)!r} cannot be read ({reason(error)}); check its permissions") from error
