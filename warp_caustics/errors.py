"""Errors a person can act on: one line with the value, the limit and the fix.

Each class carries the exit code the command line ends with, so that scripts
can tell a typing mistake from a full disk:

====  =====================================================
code  meaning
====  =====================================================
0     done
1     a bug in this software (the traceback is kept)
2     wrong usage of the command line
3     bad input or configuration
4     damaged data
5     things that do not belong together, or are locked
6     disk, memory or device
7     inspection failed: the plate is out of tolerance
130   stopped by Ctrl-C
143   stopped by SIGTERM
====  =====================================================
"""

import difflib
from collections.abc import Iterable

EXIT_BUG, EXIT_USAGE, EXIT_FAILED, EXIT_INTERRUPTED, EXIT_TERMINATED = 1, 2, 7, 130, 143
"""Codes of what no error class stands for."""


def shortened(text: str, most: int = 80) -> str:
    """Foreign text for a message: one line of at most so many characters."""
    line = " ".join(text[: 4 * most].split())
    return line if len(line) <= most else f"{line[: most - 3]}..."


def known_names(word: str, known: Iterable[str]) -> str:
    """What to use in place of an unknown name, as the end of a message: the likely one, or all."""
    names = list(known)
    close = difflib.get_close_matches(word, names, n=1)
    return f"did you mean {close[0]!r}?" if close else f"use one of {', '.join(names)}"


class CausticsError(Exception):
    """Base of all errors this package raises on purpose."""

    exit_code = EXIT_BUG


class InputError(CausticsError, ValueError):
    """A value, file or configuration that cannot be used as given."""

    exit_code = 3


class DamagedDataError(CausticsError):
    """A file that exists but whose content is broken (truncated, wrong checksum)."""

    exit_code = 4


class MismatchError(CausticsError):
    """Two things that do not belong together (scene and weights, image and scene)."""

    exit_code = 5


class ResourceError(CausticsError, RuntimeError):
    """Disk, memory or device is missing or too small."""

    exit_code = 6


def is_out_of_memory(error: Exception) -> bool:
    """Whether host or device had too little memory."""
    # torch raises torch.OutOfMemoryError; it, cuDNN and Warp also plain RuntimeErrors.
    if isinstance(error, MemoryError) or type(error).__name__ == "OutOfMemoryError":
        return True
    signs = (
        "out of memory",
        "Failed to allocate",
        "can't allocate memory",
        "CUDNN_STATUS_ALLOC_FAILED",
        "Cannot allocate memory",
        "not enough memory",
        "std::bad_alloc",
        "memory allocation failed",
    )
    return isinstance(error, RuntimeError | OSError) and any(sign in str(error) for sign in signs)
