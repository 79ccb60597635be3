"""Starts of the updater's own making.

The paper trains the updater on single steps from perturbed reliefs. What it meets
at its second step is a relief of its own making, of a kind that it never saw, and
errors grow from step to step. Here a share of the new samples start from the
network's own answer to a sample that was trained on before, and that answer to it
in turn: no step is repeated, so a sample costs what any fresh one costs.
"""

import torch

from data_gen.samples import UpdaterSampler
from nets.training.config import RunConfig
from nets.training.keys import step_generator
from warp_caustics.data_gradient import possible_heights

Batch = dict[str, torch.Tensor]


class OwnStarts:
    """Which fresh samples start where, and those that continue others.

    Args:
        config: the run; its shares.
        sampler: simulates.
        rank: which of the processes.
    """

    def __init__(self, config: RunConfig, sampler: UpdaterSampler, rank: int = 0):
        self.config, self.sampler, self.rank = config, sampler, rank

    def draws(self, round_: int) -> tuple[bool, bool]:
        """Whether a round continues samples of the pool; whether it starts flat if it does not."""
        generator = step_generator(self.config.training.seed, "own starts", round_, self.rank, torch.device("cpu"))
        own, flat = torch.rand(2, generator=generator).tolist()
        replay = self.config.training.replay
        return own < replay.own_share, flat < replay.flat_share

    def fresh(self, ids: range, is_flat: bool) -> Batch:
        """New samples, from perturbed reliefs or from a flat plate."""
        if not is_flat:
            return self.sampler.draw_tensors(ids)[0]
        heights = self.sampler.reliefs.true(ids)
        return self.sampler.at(heights, torch.zeros_like(heights), self.sampler.target(heights, ids), ids)

    def continued(self, batch: Batch, answers: torch.Tensor, ids: range) -> Batch:
        """The same samples one step further.

        Args:
            batch: samples.
            answers: of the network to them [m], shape [B, n, n].
            ids: of the new samples, for their photons.
        """
        start = possible_heights(answers, self.config.scene)
        return self.sampler.at(batch["heights"], start, batch["target"], ids)
