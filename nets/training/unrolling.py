"""Training through iterations: simulate, compare, let the network step, again.

The paper found this too expensive and trained on single steps from perturbed
heights. What the network meets at the second step are then heights of its own
making, which it has never seen.
"""

from typing import NamedTuple

import torch

from nets.training.batch import Batch
from nets.training.config import RunConfig
from nets.training.devices import Stopwatch, autocast
from nets.training.imaging import Imager
from nets.training.losses import relief_loss, relief_rmse_um
from nets.training.task import Common, Model, Sample, relief_measures
from nets.training.weights import frozen_direct_network
from nets.unrolled_net import Update
from nets.unrolling_config import UnrollingConfig


class Iterate(NamedTuple):
    """Where an iteration stands."""

    heights: torch.Tensor
    """Shape [B, n, n] [m]."""
    hidden: torch.Tensor | None
    """The network's memory."""


def unrolled_steps(config: UnrollingConfig, progress: float) -> int:
    """K, which grows in equal parts from first_steps to last_steps; progress is 0 to 1 of the whole run."""
    if progress >= config.growth_share:
        return config.last_steps
    levels = config.last_steps - config.first_steps + 1
    return config.first_steps + int(levels * progress / config.growth_share)


class UnrolledTask(Common):
    """K steps of the network with the simulator and its gradient in the loop.

    Heights are cut off from the graph between steps (unless
    ``unrolling.through_steps``): each step learns to make the best of what it
    is given. The network's memory is not cut off, or nothing would teach it
    what to remember. The simulator is never differentiated twice.

    Args:
        config: the run.
        device: where batches are.
        rank: which of the processes.
        watch: times the simulations.
    """

    objective = "val_rmse_um"

    def __init__(self, config: RunConfig, device: torch.device, rank: int, watch: Stopwatch):
        super().__init__(config, device, rank)
        self.options, self.watch = config.training.unrolling, watch
        self.imager = Imager(config.scene, self.options.photons, device)
        self.direct = frozen_direct_network(config, device)

    def loss(self, model: Model, batch: Batch, step: int, progress: float) -> torch.Tensor:
        batch = self.turned(batch, step)
        target, truth = self.seen(batch["image"], step), batch["heights"]
        at = Iterate(self._start(batch, target, step), None)
        total, weight, weights = torch.zeros((), device=self.device), 1.0, 0.0
        for number in range(unrolled_steps(self.options, progress)):
            if not self.options.through_steps:
                at = at._replace(heights=at.heights.detach())
            at = self._stepped(model, target, at, number)
            error = relief_loss(at.heights, truth, self.config.scene.sample_pitch_m, self.training.slope_weight)
            total, weights = total + weight * error, weights + weight
            weight *= self.options.step_weight_growth
        if at.hidden is not None:
            # The last memory teaches nothing, but DDP waits for a gradient of every weight.
            total = total + 0.0 * at.hidden.float().sum()
        return total / weights

    def measures(self, model: Model, batches: list[Batch]) -> dict[str, float]:
        """Errors after the first and after all ``last_steps`` steps, from flat or from the direct network."""
        start, first, last = [], [], []
        for number, batch in enumerate(batches):
            target = self.validation_image(batch, number)
            at = Iterate(self._first_guess(target), None)
            start.append(relief_rmse_um(at.heights, batch["heights"]))
            for step in range(self.options.last_steps):
                at = self._stepped(model, target, at, step)
                if step == 0:
                    first.append(relief_rmse_um(at.heights, batch["heights"]))
            last.append(relief_rmse_um(at.heights, batch["heights"]))
        return {
            **relief_measures(last),
            "val_start_rmse_um": float(torch.cat(start).mean()),
            "val_first_rmse_um": float(torch.cat(first).mean()),
        }

    def sample(self, model: Model, batch: Batch) -> Sample:
        target = self.validation_image(batch, 0)[:1]
        at = Iterate(self._first_guess(target), None)
        for step in range(self.options.last_steps):
            at = self._stepped(model, target, at, step)
        return Sample(target[0], batch["heights"][0], at.heights[0], is_height=True)

    def _stepped(self, model: Model, target: torch.Tensor, at: Iterate, number: int) -> Iterate:
        with self.watch.part():
            simulated, gradient = self.imager.with_gradient(at.heights.detach(), target)
        update: Update = model(target, simulated, at.heights, gradient, at.hidden, number)
        return Iterate(update.heights, update.hidden)

    def _start(self, batch: Batch, target: torch.Tensor, step: int) -> torch.Tensor:
        """Heights to start from, of each sample by the shares, shape [B, n, n] [m]."""
        shares = self.options.start
        whole = shares.flat + shares.perturbed + shares.direct
        generator = self.generator("start", step)
        unit = torch.rand(len(target), 1, 1, generator=generator, device=self.device) * whole
        heights = torch.where(unit < shares.perturbed, batch["start"], torch.zeros_like(batch["start"]))
        if shares.direct:
            is_direct = unit >= shares.perturbed + shares.flat
            heights = torch.where(is_direct, self._first_guess(target), heights)
        return heights

    @torch.no_grad()
    def _first_guess(self, target: torch.Tensor) -> torch.Tensor:
        """What a reconstruction starts from: the direct network's answer where there is one, else a flat plate."""
        if self.direct is None:
            samples = self.config.scene.height_samples
            return target.new_zeros(len(target), samples, samples)
        with autocast(self.training.precision, self.device):
            heights: torch.Tensor = self.direct(target)
        return heights
