"""What commands write to: folders that hold one result and nothing else, and tables."""

import os
import re
import secrets
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cli.marker import MARKER, sealed_marker, strangers, write_marker
from warp_caustics.errors import InputError
from warp_caustics.io.atomic import PathLike, reason
from warp_caustics.io.durable import is_temporary
from warp_caustics.io.exchange import finish_publication, publish_folder
from warp_caustics.io.heights import write_heights
from warp_caustics.io.journal import Journal, journal_path, only_writer
from warp_caustics.io.mesh import height_field_mesh, write_mesh
from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray

MAX_NAMED = 80
"""Characters of a list of foreign files in a message."""
_TAKEN = ("summary.csv", "plates.csv", "trend.png", MARKER)
"""Files that lie beside the folders of many results."""
_HIDDEN = ".nsfc-"
_OURS = re.compile(r"\.nsfc-[0-9a-f]{16}\Z")
"""Names of hidden folders, which take their own only when they are complete."""


def checked_folder(
    output: PathLike, is_ours: Callable[[str], bool], advice: str = "name a new folder"
) -> tuple[Path, list[str]]:
    """Path of a folder that may be written to, and the names of what it holds; nothing where there is none yet.

    Args:
        output: path as a person wrote it.
        is_ours: tells whether a name in the folder is of an earlier result.
        advice: what to do about other files.

    Raises:
        InputError: in use for something else, or no place for a folder.
    """
    path, name = Path(os.path.realpath(output)), repr(os.fspath(output))
    if not path.parent.is_dir():
        raise InputError(f"folder {str(path.parent)!r} does not exist; create it first")
    if path.is_symlink():  # what is left of a link that was followed as far as it goes
        raise InputError(f"output {name} is a symbolic link that points at itself; remove it, or name another folder")
    if not path.exists():
        return path, []
    if not path.is_dir():
        raise InputError(f"output {name} is a file; name a folder")
    held = sorted(os.listdir(path))
    foreign = [entry for entry in held if not is_ours(entry)]
    if foreign:
        raise InputError(f"output {name} holds other files ({', '.join(foreign)[:MAX_NAMED]}); {advice}")
    return path, held


def made_folder(output: str) -> Path:
    """The folder of many results, made if it is missing.

    Raises:
        InputError: no place for a folder.
    """
    folder = Path(os.path.realpath(output))
    if not folder.parent.is_dir():
        raise InputError(f"folder {str(folder.parent)!r} does not exist; create it first")
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise InputError(f"output {output!r} cannot be made a folder ({reason(error)}); name another") from error
    return folder


def result_name(image: PathLike) -> str:
    """Name of the folder that an image's result goes to: its own without the suffix, where that is a name.

    ``...tif`` would give ``..``, the folder above, and ``summary.csv.tif`` the name of a table.
    """
    path = Path(image)
    return path.name if path.stem in _TAKEN or not path.stem.strip(".") else path.stem


def result_names(images: Sequence[str]) -> dict[str, str]:
    """Name of the folder that each image's result goes to.

    Raises:
        InputError: two images of one name.
    """
    owners: dict[str, str] = {}
    for image in images:
        stem = result_name(image)
        if stem in owners:
            raise InputError(
                f"{owners[stem]!r} and {image!r} would both go to the folder {stem!r}; rename one, or make two calls"
            )
        owners[stem] = image
    return {image: stem for stem, image in owners.items()}


@dataclass(frozen=True)
class ResultKind:
    """Folders that hold one result.

    Attributes:
        name: in their marker.
        files: all that such a result may consist of.
    """

    name: str
    files: tuple[str, ...]


def check_target(target: PathLike, force: bool, kind: ResultKind, inputs: Iterable[PathLike] = ()) -> Path:
    """Path of a result folder, if it may be written.

    Args:
        target: path as given by a person.
        force: an earlier result there may be replaced.
        kind: of the result.
        inputs: files that are read.

    Raises:
        InputError: in use for something else, the place of an input, or no place for a folder.
    """
    path, name = Path(os.path.realpath(target)), repr(os.fspath(target))
    if path == Path.cwd() or path in Path.cwd().parents:
        raise InputError(f"output {name} is the folder you are in, or holds it; name a new folder")
    check_apart(target, inputs)
    path, held = checked_folder(target, lambda entry: True)
    if not held:
        return path
    foreign, changed = strangers(path, kind.name, kind.files.__contains__)
    if foreign:
        raise InputError(f"output {name} holds other files ({listed(foreign)}); name a new folder")
    if changed:
        raise InputError(
            f"output {name} holds files that were changed since they were written ({listed(changed)}); "
            "move them away, or name a new folder"
        )
    if not force:
        raise InputError(f"output {name} holds an earlier result; name a new folder, or replace it with --force")
    return path


@contextmanager
def result_folder(target: Path, force: bool, kind: ResultKind) -> Iterator[Path]:
    """Fill a folder that takes its name only when the block ends well.

    Yields a hidden folder beside ``target``. When the block raises (Ctrl-C and
    SIGTERM included) it is removed, and an earlier result stays as it was. What
    a kill leaves behind, the next command for the same target removes. Somebody
    else's files that appeared meanwhile stay, and the result gets another name.

    Args:
        target: path that :func:`check_target` returned.
        force: replace an earlier result.
        kind: of the result.

    Raises:
        MismatchError: another process writes this result.
    """
    with only_writer(journal_path(target), target) as journal:
        _end_former(journal.left, target, kind)
        check_target(target, force, kind)
        temporary = target.with_name(f"{_HIDDEN}{secrets.token_hex(8)}")
        journal.note({"state": "writing", "folder": temporary.name})
        try:
            temporary.mkdir()
        except OSError as error:
            raise InputError(f"cannot create {str(target)!r} ({reason(error)}); choose another folder") from error
        try:
            yield temporary
            write_marker(temporary, sealed_marker(kind.name, temporary))
            _publish(temporary, target, force, kind, journal)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)


def _publish(temporary: Path, target: Path, force: bool, kind: ResultKind, journal: Journal) -> None:
    try:
        check_target(target, force, kind)
        former = sorted(os.listdir(target)) if target.exists() else []
        journal.note({"state": "publishing", "folder": temporary.name, "former": former})
        old = publish_folder(temporary, target)
    except (InputError, OSError) as error:
        # Hours of work must not be lost because a name was taken meanwhile.
        kept = target.with_name(f"{target.name[:200]}.{temporary.name.removeprefix(_HIDDEN)}")
        os.rename(temporary, kept)
        text = str(error) if isinstance(error, InputError) else f"cannot replace {str(target)!r} ({reason(error)})"
        raise InputError(f"{text}; the result is complete, in {str(kept)!r}") from error
    if old is not None:
        _clear(old, former, target)


def _end_former(left: Mapping[str, Any], target: Path, kind: ResultKind) -> None:
    """End or undo what a killed writer of this target had begun."""
    folder = str(left.get("folder", ""))
    if not _OURS.match(folder):
        return
    temporary = target.with_name(folder)
    if left.get("state") == "writing":
        _clear(temporary, (*kind.files, MARKER), None)
        return
    over = finish_publication(temporary, target)
    if over is not None:
        # Either the former result, or the new one that had not got its name yet.
        _clear(over, (*map(str, left.get("former", ())), *kind.files, MARKER), target)


def _clear(folder: Path, names: Iterable[str], target: Path | None) -> None:
    """Remove files of a hidden folder, and the folder; what else is in it goes to the target, where that has room."""
    if folder.is_symlink() or not folder.is_dir():
        return
    ours = set(names)
    for entry in sorted(os.listdir(folder)):
        path = folder / entry
        if entry in ours or is_temporary(entry):
            if not path.is_dir() or path.is_symlink():
                path.unlink(missing_ok=True)
        elif target is not None and not os.path.lexists(target / entry):
            os.rename(path, target / entry)
    with suppress(OSError):
        folder.rmdir()


def check_apart(output: PathLike, inputs: Iterable[PathLike]) -> None:
    """Refuse an output that is an input, or a folder with one in it, under whatever names.

    Raises:
        InputError: names both.
    """
    path = os.path.realpath(output)
    for given in inputs:
        # A link in the folder counts as well as what it points to.
        places = {os.path.realpath(given), os.path.join(os.path.realpath(os.path.dirname(given)), _base(given))}
        same = os.path.exists(output) and os.path.exists(given) and os.path.samefile(output, given)
        if same or path in places:
            raise InputError(f"output {os.fspath(output)!r} is the input {os.fspath(given)!r}; give another name")
        if any(place.startswith(os.path.join(path, "")) for place in places):
            raise InputError(
                f"input {os.fspath(given)!r} is in the output {os.fspath(output)!r}, which would be replaced; "
                "name another folder"
            )


def check_file(output: PathLike, force: bool, inputs: Iterable[PathLike] = (), option: str = "output") -> None:
    """Refuse a file that is an input, or that is there already and may not be replaced.

    Raises:
        InputError: with the way out.
    """
    check_apart(output, inputs)
    if os.path.lexists(output) and not force:
        raise InputError(f"{option} {os.fspath(output)!r} exists; give another name, or replace it with --force")


def _base(path: PathLike) -> str:
    return os.path.basename(os.fspath(path))


def listed(names: Sequence[str]) -> str:
    """Names for a message, as many as fit."""
    return ", ".join(names)[:MAX_NAMED]


def write_print(folder: Path, heights_m: FloatArray, scene: Scene) -> None:
    """Write a relief for programs and printers: ``height.npy``, ``height.tif`` and ``surface.stl``."""
    write_heights(folder / "height.npy", heights_m)
    write_heights(folder / "height.tif", heights_m)
    write_mesh(folder / "surface.stl", height_field_mesh(heights_m, scene.plate_size_m, scene.base_thickness_m))
