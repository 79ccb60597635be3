"""Files at the edge of the program: safe to open, whole or absent when written.

Reading: a path given by a person may be a folder, a pipe or ``/dev/zero``;
:func:`regular_file` turns each into one clear line and never blocks.
Writing: :func:`atomic_path` lets a writer fill a temporary file that takes the
final name only when it is complete and on disk. Not handled: network file
systems on which rename is not atomic.
"""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from warp_caustics.errors import InputError, ResourceError
from warp_caustics.io.durable import machine_mend, settle, temporary_name
from warp_caustics.io.regular import IrregularFileError, kind_of, open_regular, read_regular
from warp_caustics.io.regular import PathLike as PathLike


def reason(error: BaseException) -> str:
    """The message of a foreign error on one short line, its type where it has no message."""
    return " ".join(str(error).split())[:200] or type(error).__name__


def _explained(error: OSError | ValueError, name: str) -> str:
    code = error.errno if isinstance(error, OSError) else None
    explanations = {
        errno.ENOENT: f"{name} does not exist; check the spelling",
        errno.ENOTDIR: f"{name} does not exist, a part of its path is no folder; check the spelling",
        errno.ELOOP: f"{name} is a symbolic link that points at itself; give the file",
        errno.EACCES: f"{name} may not be read by this user; change its permissions",
        errno.ENAMETOOLONG: f"{name[:60]}... is too long for a file name; shorten it",
    }
    return explanations.get(code or 0, f"{name} cannot be opened ({reason(error)}); give a readable file")


def regular_file(path: PathLike) -> Path:
    """Check that a path names a readable, regular, non-empty file.

    Args:
        path: path as given by a person.

    Raises:
        InputError: missing, a folder, a pipe, a device, unreadable, empty or a web address.
    """
    name = repr(os.fspath(path))
    if "://" in name:
        raise InputError(f"{name} is a web address; download the file and give its path")
    try:
        with open_regular(path) as file:
            size = os.fstat(file.fileno()).st_size
    except IrregularFileError as error:
        raise InputError(f"{name} {(error.strerror or str(error)).removeprefix('it ')}; give a file") from error
    except (OSError, ValueError) as error:
        raise InputError(_explained(error, name)) from error
    if size == 0:
        raise InputError(f"{name} is empty (0 bytes); export or copy it again")
    return Path(path)


def read_text(path: PathLike, max_bytes: int) -> str:
    """Text of a small file, UTF-8 with or without a byte order mark.

    Raises:
        InputError: as :func:`regular_file`, more than ``max_bytes``, or no UTF-8.
    """
    file = regular_file(path)
    name = repr(os.fspath(path))
    try:
        return read_regular(file, max_bytes).decode("utf-8-sig")
    except IrregularFileError as error:
        raise InputError(f"{name} has more than {max_bytes:,} bytes; give a file that a person writes") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{name} is no text in UTF-8; give a text file") from error
    except OSError as error:
        raise InputError(_explained(error, name)) from error


def _write_target(path: PathLike) -> Path:
    name = repr(os.fspath(path))
    try:
        # Through a symbolic link the file behind it is replaced, as an ordinary write would do.
        target = Path(os.path.realpath(path))
        mode = target.lstat().st_mode if os.path.lexists(target) else None
        parent_is_folder = target.parent.is_dir()
    except (OSError, ValueError) as error:
        raise InputError(f"{name} cannot be written ({reason(error)}); give another path") from error
    kind = None if mode is None else kind_of(mode)
    if kind is not None:
        # os.replace would happily swap a device node for a file.
        raise InputError(f"{name} is {kind}, not a file to overwrite; give another name")
    if not parent_is_folder:
        raise InputError(f"folder {str(target.parent)!r} does not exist; create it first")
    if len(os.fsencode(target.name)) > 255:
        raise InputError(f"file name {target.name[:40]!r}... is longer than 255 bytes; shorten it")
    return target


@contextmanager
def atomic_path(path: PathLike) -> Iterator[Path]:
    """Write a file so that it appears complete or not at all.

    Yields a temporary path in the same folder with the same suffix. When the
    block ends it is fsynced and renamed to ``path``; when the block raises
    (Ctrl-C included) it is removed and an older ``path`` stays as it was.
    A kill -9 leaves the temporary file (``.tmp-*``), never half of ``path``.

    Args:
        path: final path; an existing regular file is replaced.

    Raises:
        InputError: the folder is missing or not writable, or ``path`` is no regular file.
        ResourceError: the disk is full or broken, or files may not be as large.
    """
    target = _write_target(path)
    temporary = temporary_name(target, target.suffix[:32])
    try:
        yield temporary
        settle(temporary, target)
    except OSError as error:
        mend = machine_mend(error)
        if mend is not None:
            raise ResourceError(f"cannot write {str(target)!r} ({reason(error)}); {mend}") from error
        if error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
            raise InputError(f"folder {str(target.parent)!r} is not writable; choose another") from error
        raise
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: PathLike, text: str) -> None:
    """Write UTF-8 text, complete or not at all; errors as of :func:`atomic_path`.

    Names of files that are no text are spelled with backslashes: a result must not be lost because of its name.
    """
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8", errors="backslashreplace")
