"""Where light paths end."""

from typing import NamedTuple

import torch


class Landings(NamedTuple):
    """What becomes of light paths; tensors on the engine's device."""

    positions_px: torch.Tensor
    """On the screen [px], shape [B, n_w, 2, N]."""
    energies: torch.Tensor
    """Flux for unit radiosity over the pixel's area, before the plate, shape [B, n_w, N]."""
    shares: torch.Tensor
    """Share of it that both faces let through, relative to a flat plate, shape [B, n_w, N]."""
    fates: torch.Tensor
    """Numbers of ``FATE_NAMES``, shape [B, n_w, N]."""
