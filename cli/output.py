"""What commands write to: folders that hold one result and nothing else, and tables."""

import os
import secrets
import shutil
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from warp_caustics.errors import InputError
from warp_caustics.io.atomic import PathLike, reason
from warp_caustics.io.heights import write_heights
from warp_caustics.io.mesh import height_field_mesh, write_mesh
from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray

MAX_NAMED = 80
"""Characters of a list of foreign files in a message."""


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


def result_names(images: Sequence[str]) -> dict[str, str]:
    """Name of the folder that each image's result goes to.

    Raises:
        InputError: two images of one name.
    """
    owners: dict[str, str] = {}
    for image in images:
        stem = Path(image).stem
        if stem in owners:
            raise InputError(
                f"{owners[stem]!r} and {image!r} would both go to the folder {stem!r}; rename one, or make two calls"
            )
        owners[stem] = image
    return {image: stem for stem, image in owners.items()}


def check_target(target: PathLike, force: bool, files: Collection[str]) -> Path:
    """Path of a result folder, if it may be written.

    Args:
        target: path as given by a person.
        force: an earlier result there may be replaced.
        files: what such a result consists of.

    Raises:
        InputError: in use for something else, or no place for a folder.
    """
    path, name = Path(os.path.realpath(target)), repr(os.fspath(target))
    if path == Path.cwd() or path in Path.cwd().parents:
        raise InputError(f"output {name} is the folder you are in; name a new folder")
    path, held = checked_folder(target, files.__contains__)
    if held and not force:
        raise InputError(f"output {name} holds an earlier result; name a new folder, or replace it with --force")
    return path


@contextmanager
def result_folder(target: Path, force: bool, files: Collection[str]) -> Iterator[Path]:
    """Fill a folder that takes its name only when the block ends well.

    Yields a hidden folder beside ``target``. When the block raises (Ctrl-C and
    SIGTERM included) it is removed, and an earlier result stays as it was.

    Args:
        target: path that :func:`check_target` returned.
        force: replace an earlier result.
        files: what such a result consists of.
    """
    temporary = target.with_name(f".{target.name}.{secrets.token_hex(4)}")
    try:
        temporary.mkdir()
    except OSError as error:
        raise InputError(f"cannot create {str(target)!r} ({reason(error)}); choose another folder") from error
    try:
        yield temporary
        _publish(temporary, check_target(target, force, files))
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _publish(temporary: Path, target: Path) -> None:
    if not target.exists():
        temporary.rename(target)
        return
    # rename() does not replace a folder with content: the old one steps aside, and back if that fails.
    old = temporary.with_name(f"{temporary.name}.old")
    target.rename(old)
    try:
        temporary.rename(target)
    except BaseException:
        old.rename(target)
        raise
    shutil.rmtree(old, ignore_errors=True)


def write_print(folder: Path, heights_m: FloatArray, scene: Scene) -> None:
    """Write a relief for programs and printers: ``height.npy``, ``height.tif`` and ``surface.stl``."""
    write_heights(folder / "height.npy", heights_m)
    write_heights(folder / "height.tif", heights_m)
    write_mesh(folder / "surface.stl", height_field_mesh(heights_m, scene.plate_size_m, scene.base_thickness_m))
