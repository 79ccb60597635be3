"""Folders that commands come back to: marked as theirs before anything in them is written."""

import os
from collections.abc import Callable, Collection, Sequence
from pathlib import Path

from cli.marker import MARKER, is_regular, new_marker, read_marker, write_marker
from cli.output import checked_folder, listed
from warp_caustics.errors import InputError
from warp_caustics.io.atomic import PathLike
from warp_caustics.io.durable import is_temporary


def claim_folder(
    output: PathLike, kind: str, names: Collection[str], is_ours: Callable[[Path], bool], advice: str
) -> Path:
    """The folder of a command that goes on where it stopped, made and marked if there is none.

    Args:
        output: path as given by a person.
        kind: of the marker.
        names: that such a folder holds at its top.
        is_ours: whether a folder is of a version that left no marker.
        advice: what to do about other files.

    Raises:
        InputError: it holds other files, or there is no place for it.
    """
    path, held = checked_folder(output, lambda name: True)
    marker = read_marker(path)
    is_known = marker is not None and marker.kind == kind
    if held and (not is_known if MARKER in held else not is_ours(path)):
        foreign = held
    else:
        foreign = [name for name in held if name not in names and name != MARKER and not is_temporary(name)]
    if foreign:
        raise InputError(f"output {os.fspath(output)!r} holds other files ({listed(foreign)}); {advice}")
    path.mkdir(exist_ok=True)
    if marker is None:
        write_marker(path, new_marker(kind, names))
    return path


def claim_files(folder: Path, kind: str, names: Sequence[str], is_ours: Callable[[], bool]) -> None:
    """Mark the files that a command keeps up to date in a folder which may hold others as well.

    Args:
        folder: exists.
        kind: of the marker.
        names: of the files.
        is_ours: whether files of these names are of a version that left no marker.

    Raises:
        InputError: a file of such a name is somebody else's.
    """
    marker = read_marker(folder)
    if marker is not None and marker.kind == kind and set(names) <= marker.files.keys():
        foreign = [name for name in names if os.path.lexists(folder / name) and not is_regular(folder / name)]
    else:
        foreign = [name for name in names if os.path.lexists(folder / name)]
        if foreign and is_ours():
            foreign = [name for name in foreign if not is_regular(folder / name)]
        if os.path.lexists(folder / MARKER):
            foreign.append(MARKER)
    if foreign:
        raise InputError(f"output {str(folder)!r} holds other files ({listed(foreign)}); name a new folder")
    if marker is None:
        write_marker(folder, new_marker(kind, names))
