"""Optimiser, gradients that are cut, learning rate over the run, and the running average of the weights."""

import copy
import math

import torch
from torch import nn

from nets.training.config import TrainingConfig


def make_optimiser(network: nn.Module, config: TrainingConfig, device: torch.device) -> torch.optim.Optimizer:
    """Adam or AdamW; weight decay only for kernels: a smaller bias, norm or slope of a PReLU is no simpler network."""
    trained = [p for p in network.parameters() if p.requires_grad]
    groups = [
        {"params": [p for p in trained if p.ndim > 1], "weight_decay": config.weight_decay},
        {"params": [p for p in trained if p.ndim <= 1], "weight_decay": 0.0},
    ]
    kind = torch.optim.AdamW if config.optimiser == "adamw" else torch.optim.Adam
    is_fused = device.type == "cuda"
    return kind([group for group in groups if group["params"]], lr=config.learning_rate, fused=is_fused)


MEMORY = 0.02
"""Share of the latest gradient in the running mean of their norms."""


def clip_gradients(network: nn.Module, config: TrainingConfig, mean_norm: torch.Tensor) -> None:
    """Shorten long gradients, without waiting for the device.

    A batch whose gradient is many times longer than those before it moves Adam far: its second moments have not
    seen such yet. One such step undid 2,000 others of ``direct`` (batches of 256, rate 1e-3, ``clip_norm`` 1, which
    is far above what gradients usually are).

    Args:
        network: its gradients are changed in place.
        config: gives ``clip_norm`` and ``clip_spikes``.
        mean_norm: running mean of the norms, scalar, changed in place; 0 before the first.
    """
    gradients = [p.grad for p in network.parameters() if p.grad is not None]
    if not gradients or (config.clip_norm is None and config.clip_spikes is None):
        return
    norm = torch.nn.utils.get_total_norm(gradients)
    limit = torch.full_like(norm, config.clip_norm or math.inf)
    if config.clip_spikes is not None:
        limit = torch.where(mean_norm > 0, torch.minimum(limit, config.clip_spikes * mean_norm), limit)
        seen = torch.where(norm.isfinite(), torch.minimum(norm, limit), mean_norm)
        mean_norm.copy_(torch.where(mean_norm > 0, mean_norm + MEMORY * (seen - mean_norm), seen))
    # Scaled by the limit, which is then a number that the host knows.
    torch.nn.utils.clip_grads_with_norm_(network.parameters(), 1.0, norm / limit)


def learning_rate(config: TrainingConfig, step: int, progress: float) -> float:
    """Rate of one step: linear warm-up, then constant or half a cosine down to ``final_rate``.

    Args:
        config: gives all of it.
        step: number of the step, from 0.
        progress: 0 at the start of the whole run, 1 at its end.
    """
    rate = config.learning_rate
    if config.schedule == "cosine":
        low = config.final_rate
        rate *= low + (1 - low) * 0.5 * (1 + math.cos(math.pi * min(max(progress, 0.0), 1.0)))
    if step < config.warmup_steps:
        rate *= (step + 1) / config.warmup_steps
    return rate


class WeightAverage:
    """Exponential moving average of the weights (EMA); the copy is a network of its own.

    In the first steps it forgets faster, min(decay, (1 + t) / (10 + t)), or it
    would remember the random start.

    Args:
        network: what is trained.
        decay: 0 keeps the copy equal to the network.
    """

    def __init__(self, network: nn.Module, decay: float):
        self.decay = decay
        self.network = copy.deepcopy(network).requires_grad_(False).eval()
        self._pairs = list(zip(self.network.parameters(), network.parameters(), strict=True))
        self._buffers = list(zip(self.network.buffers(), network.buffers(), strict=True))

    @torch.no_grad()
    def update(self, step: int) -> None:
        """Take the weights after step number ``step`` (from 0) into the average."""
        decay = min(self.decay, (1 + step) / (10 + step)) if self.decay else 0.0
        ours, theirs = [a.data for a, _ in self._pairs], [b.data for _, b in self._pairs]
        torch._foreach_lerp_(ours, theirs, 1.0 - decay)
        for kept, current in self._buffers:
            kept.copy_(current)
