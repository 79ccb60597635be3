"""Results on a GPU that are the same to the last bit, where that is asked for; on a CPU they always are.

Asked for by an environment variable, so that simulators wherever they are made, and other processes, know. What it
changes: light and gradients are added in whole numbers (``kernels/fixed_point.py``), and torch takes its deterministic
algorithms. ``docs/limits.md`` tells what holds and what it costs.
"""

import os
import warnings

from warp_caustics.errors import InputError

VARIABLE = "NSFC_DETERMINISTIC"
"""1 asks for it; 0, empty or missing does not."""

_CUBLAS = "CUBLAS_WORKSPACE_CONFIG", ":4096:8"


def is_deterministic() -> bool:
    """Whether results on a GPU are to be the same every time.

    Raises:
        InputError: the variable is neither 0 nor 1.
    """
    value = os.environ.get(VARIABLE, "")
    if value not in ("", "0", "1"):
        raise InputError(
            f"{VARIABLE} is {value[:20]!r}, neither 0 nor 1; set it to 1 for results that repeat, or unset it"
        )
    return value == "1"


def make_deterministic(is_wanted: bool = True) -> None:
    """Ask for it, if it is wanted, from now on, here and in processes that are started; simulators stay as they are."""
    if is_wanted:
        os.environ[VARIABLE] = "1"
        # cuBLAS reads it once, before its first product.
        os.environ.setdefault(*_CUBLAS)


def settle_gpu() -> None:
    """Let torch's operations on a GPU be deterministic if that is asked for; nothing otherwise.

    Called wherever a GPU is about to be used. Operations that have no deterministic form warn and go on.
    """
    if not is_deterministic():
        return
    import torch

    os.environ.setdefault(*_CUBLAS)
    torch.use_deterministic_algorithms(True, warn_only=True)
    # Memory that is not yet written is read by none of ours; filling it would cost a launch each time.
    torch.utils.deterministic.fill_uninitialized_memory = False  # type: ignore[attr-defined]
    torch.backends.cudnn.benchmark = False
    torch.backends.cudnn.deterministic = True
    # With warnings instead of errors the fused forms of attention stay with gradients that are added in any order.
    torch.backends.cuda.enable_flash_sdp(False)
    torch.backends.cuda.enable_mem_efficient_sdp(False)
    torch.backends.cuda.enable_cudnn_sdp(False)
    # torch warns of every running sum; only those along a whole array of one dimension are in any order, and none of
    # ours is (reconstruct/seen_camera/blur_estimate.py).
    warnings.filterwarnings("ignore", message="cumsum_cuda_kernel does not have a deterministic")
