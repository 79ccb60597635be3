"""What a batch is, and what makes batches.

A batch is a dictionary of float32 tensors on the device:

=========  ====================================================================
kind       entries
=========  ====================================================================
denoiser   noisy, clean: shape [B, n_w, m, m] [W/m^2]
updater    heights, start, gradient: [B, n, n]; target, simulated: [B, n_w, m, m]
direct     image: [B, n_w, m, m]; heights: [B, n, n] [m]
unrolled   image, heights, start
told       as direct, and bench: [B, P - 2], parameters of each sample's bench;
           in validation default_image besides, of the same plates on the
           run's scene; with feedback what
           :class:`nets.training.seeing.Given` lists
=========  ====================================================================

``told`` is ``direct`` with ``training.bench``.
"""

from collections.abc import Callable
from typing import Protocol

import torch

Batch = dict[str, torch.Tensor]

Told = Callable[[int, int], None]
"""Hears how many samples of how many are made."""


def silent(done: int, total: int) -> None:
    """Hears nothing."""


IMAGES = {
    "denoiser": ("noisy", "clean"),
    "updater": ("target", "simulated"),
    "direct": ("image",),
    "unrolled": ("image",),
}
"""Entries of a batch that are images."""
HEIGHT_MAPS = {"denoiser": 0, "updater": 3, "direct": 1, "unrolled": 2}
"""Entries of a batch that have the shape of the heights."""


class Source(Protocol):
    """Batches by their number; each is a function of the configuration, its number and the rank."""

    steps_per_epoch: int
    """Batches until the next validation."""

    def batch(self, step: int) -> Batch:
        """Batch number ``step``; asked for in rising order."""

    def resume(self, step: int) -> None:
        """Prepare for ``step`` being the next batch asked for."""

    def validation(self, told: Told = silent) -> list[Batch]:
        """The fixed batches that networks are judged by; ``told`` hears of each."""

    def close(self) -> None:
        """Release threads and processes."""
