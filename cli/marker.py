"""A marker in each folder that a command wrote says so: what it is, and which files it wrote with which content.

Only that is ever replaced or removed. Folders of versions that left no marker
are known by their record: a file with the keys that only this program writes.
"""

import json
import os
import secrets
import stat
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cli.provenance import now
from warp_caustics.io import hashes
from warp_caustics.io.durable import is_temporary
from warp_caustics.io.json_file import write_json
from warp_caustics.io.regular import read_regular

MARKER = ".nsfc.json"
FORMAT = 1
_MOST_BYTES = 2**20


@dataclass(frozen=True)
class Marker:
    """What a folder says about itself.

    Attributes:
        kind: what it holds: reconstruction, inspection, design, test fields, run, search, comparison, batch, series.
        id: of this result or run.
        files: hash of each file by its name; empty for files that change while the folder is in use.
    """

    kind: str
    id: str
    files: Mapping[str, str]


def new_marker(kind: str, names: Iterable[str]) -> Marker:
    """A marker of files that change, with an id of its own."""
    return Marker(kind, secrets.token_hex(8), dict.fromkeys(names, ""))


def sealed_marker(kind: str, folder: Path) -> Marker:
    """A marker of all that is in a folder now, by content."""
    names = sorted(name for name in os.listdir(folder) if name != MARKER)
    return Marker(kind, secrets.token_hex(8), {name: hashes.file_sha256(folder / name) for name in names})


def write_marker(folder: Path, marker: Marker) -> None:
    """Mark a folder."""
    record = {"written_by": "nsfc", "format": FORMAT, "kind": marker.kind, "id": marker.id, "created": now()}
    write_json(folder / MARKER, {**record, "files": marker.files})


def read_marker(folder: Path) -> Marker | None:
    """The marker of a folder; None where there is none that this program wrote."""
    tree = _json(folder / MARKER)
    files = tree.get("files")
    if tree.get("written_by") != "nsfc" or tree.get("format") != FORMAT or not isinstance(files, dict):
        return None
    if not isinstance(tree.get("kind"), str) or not isinstance(tree.get("id"), str):
        return None
    return Marker(tree["kind"], tree["id"], {str(name): str(digest) for name, digest in files.items()})


RESULT_KEYS = frozenset({"method", "residual", "config_fingerprint", "versions", "inputs", "created"})
DESIGN_KEYS = frozenset({"picture", "relief", "config_fingerprint", "versions", "created"})
TESTSET_KEYS = frozenset({"fields", "flat_guess_rmse_um", "noise_std_of_flat", "photons", "scene"})


def unmarked_kind(folder: Path) -> str | None:
    """Kind of a result of a version that left no marker; None where nothing says so."""
    if _has(folder / "testset.json", TESTSET_KEYS):
        return "test fields"
    if not is_regular(folder / "config.resolved.yaml"):
        return None
    if _has(folder / "inspection.json", frozenset({"verdict", "tolerance_m", "config_fingerprint", "versions"})):
        return "inspection"
    if _has(folder / "result.json", RESULT_KEYS):
        return "reconstruction"
    return "design" if _has(folder / "result.json", DESIGN_KEYS) else None


def strangers(folder: Path, kind: str, known: Callable[[str], bool]) -> tuple[list[str], list[str]]:
    """Names in a folder that are not of a result of that kind, and names of its files that were changed since.

    Args:
        folder: exists.
        kind: of the result.
        known: names that results without a marker may hold.
    """
    held = sorted(name for name in os.listdir(folder) if name != MARKER or not is_regular(folder / name))
    marker = read_marker(folder)
    if marker is None:
        ours = unmarked_kind(folder) == kind
        foreign = [name for name in held if not (ours and known(name) and is_regular(folder / name))]
        # A marker that nobody can read is somebody's file too.
        return foreign + ([MARKER] if os.path.lexists(folder / MARKER) and MARKER not in foreign else []), []
    if marker.kind != kind:
        return held, []
    listed = [name for name in held if name in marker.files and is_regular(folder / name)]
    changed = [
        name for name in listed if marker.files[name] and hashes.file_sha256(folder / name) != marker.files[name]
    ]
    return [name for name in held if name not in listed and not is_temporary(name)], changed


def is_regular(path: Path) -> bool:
    """Whether a path is a file itself: no link, folder or pipe."""
    try:
        return stat.S_ISREG(os.lstat(path).st_mode)
    except OSError:
        return False


def _has(path: Path, keys: frozenset[str]) -> bool:
    return keys <= _json(path).keys()


def _json(path: Path) -> dict[str, Any]:
    """An object of a file that may be anything; empty where it is none."""
    try:
        if not is_regular(path) or os.stat(path).st_size > _MOST_BYTES * 64:
            return {}
        tree = json.loads(read_regular(path))
    except (OSError, ValueError, RecursionError):
        return {}
    return tree if isinstance(tree, dict) else {}
