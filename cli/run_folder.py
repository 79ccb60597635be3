"""The folder of a training: whose it is, what in it may be removed, and who writes it."""

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from cli.marker import MARKER, is_regular, new_marker, read_marker, write_marker
from cli.output import checked_folder
from cli.train_config import RESOLVED
from warp_caustics.errors import CausticsError, InputError
from warp_caustics.io.durable import is_temporary, sweep
from warp_caustics.io.journal import only_writer

KIND = "run"
LOCK = ".lock"
RUN_FILES = (
    MARKER, LOCK, RESOLVED, "metrics.csv", "weights.safetensors",
    "checkpoints/last.ckpt", "checkpoints/previous.ckpt", "checkpoints/best.ckpt", "checkpoints/.previous.ckpt.new",
)  # fmt: skip
"""Files that a run writes, and with those of the patterns all that --force removes."""
RUN_PATTERNS = (r"pictures/step-\d{8,}\.png", r"tensorboard/events\.out\.tfevents\.[^/]+")
RUN_FOLDERS = ("checkpoints", "pictures", "tensorboard")


@contextmanager
def run_folder(folder: Path, *, force: bool, resume: bool) -> Iterator[None]:
    """Make the folder of a new run, or enter that of an earlier one; nobody else trains into it meanwhile.

    Args:
        folder: of the run.
        force: remove an earlier run in it.
        resume: go on with the run in it.

    Raises:
        InputError: it holds a run or something else.
        MismatchError: another process trains into it.
    """
    folder, _ = checked_folder(folder, lambda name: True)
    _check_own(folder)
    folder.mkdir(exist_ok=True)
    # Only now is the folder known as ours: a lock is a file that is written to.
    with only_writer(folder / LOCK, folder, keep=True):
        _check_own(folder)
        if not resume:
            _clear(folder, force)
        if read_marker(folder) is None:
            write_marker(folder, new_marker(KIND, (*RUN_FILES, *RUN_PATTERNS)))
        yield


def _check_own(folder: Path) -> None:
    """Refuse a folder with anything in it that no run wrote."""
    if not folder.exists():
        return
    held = _held(folder)
    marker = read_marker(folder)
    ours = (marker is not None and marker.kind == KIND) or (marker is None and _is_unmarked_run(folder))
    foreign = [name for name in held if not (ours and _is_of_run(folder, name))]
    # A start that was killed before it wrote its marker leaves a lock; whoever takes it sees whether it is one.
    foreign = [name for name in foreign if name != LOCK]
    if foreign:
        listed = ", ".join(foreign)[:80]
        raise InputError(f"output {str(folder)!r} holds other files ({listed}); name a new folder")


def _clear(folder: Path, force: bool) -> None:
    # What has no checkpoint yet has learned nothing: a start that failed needs no --force.
    has_learned = (folder / "weights.safetensors").exists() or any(folder.glob("checkpoints/*.ckpt"))
    if has_learned and not force:
        raise InputError(f"output {str(folder)!r} holds a run; continue it with --resume, or delete it with --force")
    sweep(folder, *(folder / name for name in RUN_FOLDERS))
    # The marker goes last: until then a kill leaves a folder that is known as ours.
    for name in sorted(_held(folder), key=lambda name: name in (RESOLVED, MARKER)):
        if name != LOCK and name not in RUN_FOLDERS:
            (folder / name).unlink(missing_ok=True)
    for name in RUN_FOLDERS:
        with suppress(OSError):
            (folder / name).rmdir()


def _held(folder: Path) -> list[str]:
    """Names of all that is in a folder, those in a run's own folders with the folder's name before them."""
    held: list[str] = []
    for name in sorted(os.listdir(folder)):
        path = folder / name
        if name in RUN_FOLDERS and path.is_dir() and not path.is_symlink():
            held += [f"{name}/{inner}" for inner in sorted(os.listdir(path))] or [name]
        else:
            held.append(name)
    return held


def _is_of_run(folder: Path, name: str) -> bool:
    path = folder / name
    if name in RUN_FOLDERS:
        return path.is_dir() and not path.is_symlink()
    known = name in RUN_FILES or (is_temporary(os.path.basename(name)) and os.path.dirname(name) in ("", *RUN_FOLDERS))
    known = known or any(re.fullmatch(pattern, name) for pattern in RUN_PATTERNS)
    return known and path.is_file() and not path.is_symlink()


def _is_unmarked_run(folder: Path) -> bool:
    """Whether a version that left no marker wrote the configuration of a run."""
    from warp_caustics.io.yaml_file import read_yaml

    if not is_regular(folder / RESOLVED):
        return False
    try:
        tree = read_yaml(folder / RESOLVED)
    except CausticsError:
        return False
    return {"kind", "network", "training", "scene"} <= tree.keys()
