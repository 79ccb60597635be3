"""Starting Warp without noise on standard error."""

import os

import warp as wp

from warp_caustics.kernels.made_once import made_once
from warp_caustics.native_words import native_words

# Printed by the native library whatever the log level; a machine without a GPU is nothing to warn about.
_NO_DRIVER = "Could not find or load the NVIDIA CUDA driver"


@made_once
def start_warp() -> None:
    """Initialise Warp once; everything it says on standard error but the missing CUDA driver is passed on."""
    with native_words() as said:
        wp.init()
    rest = [line for line in said if _NO_DRIVER not in line]
    if rest:
        os.write(2, ("\n".join(rest) + "\n").encode())
