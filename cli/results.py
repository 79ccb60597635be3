"""The folder of a result: complete or absent."""

import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from warp_caustics.errors import InputError
from warp_caustics.io.atomic import reason

FILES = ("height.npy", "height.tif", "surface.stl", "result.json", "overview.png", "config.resolved.yaml")
"""What a result folder holds, and all that --force may replace."""


def check_target(target: str | Path, force: bool) -> Path:
    """Path of a result folder, if it may be written.

    Args:
        target: path as given by a person.
        force: an earlier result there may be replaced.

    Raises:
        InputError: in use for something else, or no place for a folder.
    """
    path = Path(os.path.realpath(target))
    name = repr(str(target))
    if path == Path.cwd() or path in Path.cwd().parents:
        raise InputError(f"output {name} is the folder you are in; name a new folder")
    if not path.parent.is_dir():
        raise InputError(f"folder {str(path.parent)!r} does not exist; create it first")
    if not path.exists():
        return path
    if not path.is_dir():
        raise InputError(f"output {name} is a file; name a folder")
    held = sorted(os.listdir(path))
    foreign = [entry for entry in held if entry not in FILES]
    if foreign:
        raise InputError(f"output {name} holds other files ({', '.join(foreign)[:80]}); name a new folder")
    if held and not force:
        raise InputError(f"output {name} holds an earlier result; name a new folder, or replace it with --force")
    return path


@contextmanager
def result_folder(target: Path, force: bool) -> Iterator[Path]:
    """Fill a folder that takes its name only when the block ends well.

    Yields a hidden folder beside ``target``. When the block raises (Ctrl-C and
    SIGTERM included) it is removed, and an earlier result stays as it was.

    Args:
        target: path that :func:`check_target` returned.
        force: replace an earlier result.
    """
    temporary = target.with_name(f".{target.name}.{secrets.token_hex(4)}")
    try:
        temporary.mkdir()
    except OSError as error:
        raise InputError(f"cannot create {str(target)!r} ({reason(error)}); choose another folder") from error
    try:
        yield temporary
        _publish(temporary, check_target(target, force))
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
