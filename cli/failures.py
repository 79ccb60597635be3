"""What a command let through, as one line and an exit code of :mod:`warp_caustics.errors`."""

import errno
import os
import sys
import tempfile
import time
import traceback

import click

from warp_caustics.errors import EXIT_BUG, CausticsError, InputError, ResourceError, is_out_of_memory

_PLACES = {
    errno.ENAMETOOLONG: "shorten the name",
    errno.EACCES: "choose a place that this user may read and write",
    errno.EPERM: "choose a place that this user may read and write",
    errno.EROFS: "choose a place that can be written",
    errno.ELOOP: "follow the symbolic links, they lead in a circle",
    errno.ENOTDIR: "a part of the path is no folder; check the spelling",
}
"""What is wrong with a path that somebody gave, wherever it was met; the mend."""
_LONGEST_NAME = 120


def explained(error: Exception) -> tuple[str, int]:
    """Message and exit code for an error; the traceback of one that nobody foresaw goes to a file."""
    pydantic = sys.modules.get("pydantic")
    if isinstance(error, CausticsError):
        return str(error), error.exit_code
    if pydantic is not None and isinstance(error, pydantic.ValidationError):
        from warp_caustics.scene import validation_lines

        return "; ".join(validation_lines(error)), InputError.exit_code
    if is_out_of_memory(error):
        return f"out of memory; {_what_fits()}", ResourceError.exit_code
    if isinstance(error, OSError) and (mend := _machine_mend(error)) is not None:
        return f"{error}; {mend}", ResourceError.exit_code
    if isinstance(error, OSError) and error.errno in _PLACES and error.filename is not None:
        name = os.fsdecode(error.filename) if isinstance(error.filename, str | bytes) else str(error.filename)
        return f"{_shortened(name)!r}: {error.strerror}; {_PLACES[error.errno]}", InputError.exit_code
    return f"unexpected {type(error).__name__}: {str(error)[:200]}; {_keep_traceback(error)}", EXIT_BUG


def _machine_mend(error: OSError) -> str | None:
    from warp_caustics.io.durable import machine_mend  # brings NumPy, which help does without

    return machine_mend(error)


def _shortened(name: str) -> str:
    return name if len(name) <= _LONGEST_NAME else f"{name[:_LONGEST_NAME]}..."


def _what_fits() -> str:
    """What to change, with the memory that there is."""
    try:
        free = os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError):
        free = 0
    have = f"{free / 1e9:.2g} GB of memory are free: " if free > 0 else ""
    return (
        f"{have}use a smaller image (--set scene.image_pixels=256), fewer heights (--set scene.height_samples=128), "
        "fewer photons or another --device"
    )


def _keep_traceback(error: Exception) -> str:
    """Save a traceback; returns where, as a phrase."""
    text = f"{time.strftime('%Y-%m-%d %H:%M:%S')} {sys.argv}\n{''.join(traceback.format_exception(error))}"
    try:
        with tempfile.NamedTemporaryFile(
            "w", prefix="nsfc-error-", suffix=".txt", delete=False, encoding="utf-8"
        ) as file:
            file.write(text)
    except OSError:
        click.echo(text, err=True)
        return "its traceback could not be saved and stands above"
    return f"its traceback is in {file.name}, please report it"
