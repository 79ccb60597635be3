"""What a command let through, as one line and an exit code of :mod:`warp_caustics.errors`."""

import errno
import sys
import tempfile
import time
import traceback

import click

from warp_caustics.errors import EXIT_BUG, CausticsError, InputError, ResourceError, is_out_of_memory


def explained(error: Exception) -> tuple[str, int]:
    """Message and exit code for an error; the traceback of one that nobody foresaw goes to a file."""
    pydantic = sys.modules.get("pydantic")
    if isinstance(error, CausticsError):
        return str(error), error.exit_code
    if pydantic is not None and isinstance(error, pydantic.ValidationError):
        from warp_caustics.scene import validation_lines

        return "; ".join(validation_lines(error)), InputError.exit_code
    if is_out_of_memory(error):
        return "out of memory; use fewer photons, a smaller image or another device", ResourceError.exit_code
    if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EIO):
        return f"{error}; free space on the disk", ResourceError.exit_code
    return f"unexpected {type(error).__name__}: {str(error)[:200]}; {_keep_traceback(error)}", EXIT_BUG


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
