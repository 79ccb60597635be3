"""What native libraries write to standard error themselves, past Python: caught, so that it can be told or left out."""

import contextlib
import os
import sys
import tempfile
from collections.abc import Iterator


@contextlib.contextmanager
def native_words() -> Iterator[list[str]]:
    """Catch what is written to standard error's descriptor meanwhile, by every thread of this process.

    Yields:
        Lines, of which there are none before the end. Where standard error is closed nothing is caught.
    """
    lines: list[str] = []
    try:
        saved = os.dup(2)
    except OSError:
        yield lines
        return
    with contextlib.ExitStack() as ends, tempfile.TemporaryFile() as caught:
        ends.callback(os.close, saved)
        # Python's own words, which it may still hold, go where they were meant to.
        with contextlib.suppress(OSError, ValueError, AttributeError):
            sys.stderr.flush()
        os.dup2(caught.fileno(), 2)
        try:
            yield lines
        finally:
            os.dup2(saved, 2)
            caught.seek(0)
            lines += caught.read().decode(errors="replace").splitlines()
