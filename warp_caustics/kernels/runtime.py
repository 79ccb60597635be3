"""Starting Warp without noise on standard error."""

import os
import sys
import tempfile
from functools import cache

import warp as wp

# Printed by the native library whatever the log level; a machine without a GPU is nothing to warn about.
_NO_DRIVER = b"Could not find or load the NVIDIA CUDA driver"


@cache
def start_warp() -> None:
    """Initialise Warp once; everything it says on standard error but the missing CUDA driver is passed on."""
    sys.stderr.flush()
    with tempfile.TemporaryFile() as caught:
        saved = os.dup(2)
        try:
            os.dup2(caught.fileno(), 2)
            wp.init()
        finally:
            os.dup2(saved, 2)
            os.close(saved)
        caught.seek(0)
        rest = [line for line in caught.readlines() if _NO_DRIVER not in line]
    if rest:
        os.write(2, b"".join(rest))
