"""Answers of a network in training, and their echoes: what it is given when it looks at an image again.

A reconstruction simulates what the network answered on the bench that it is told, and lets the network compare.
Training does the same with the network as it is at that moment: whatever it gets wrong, it meets. Once for each fresh
sample: what is told of the bench is drawn with it, as the simulation needs a scene, and stays as long as the sample is
in a pool; cameras are drawn anew for each visit.
"""

from collections.abc import Sequence
from typing import NamedTuple

import torch

from nets.told import CAMERA, ToldTable, filled
from nets.told_scene import told_scene
from nets.training.batch import Batch
from nets.training.config import LATTICE, RunConfig
from nets.training.imaging import BenchImager
from nets.training.keys import step_generator, step_seed
from nets.training.seeing import Given, Seen, Viewer
from nets.training.task import Model
from nets.training.telling import Teller, with_camera
from warp_caustics.data_gradient import DEEPEST_TRENCH, HIGHEST_RELIEF_M
from warp_caustics.scene import Scene

CPU = torch.device("cpu")


class ToldPlates(NamedTuple):
    """What is told of a batch of benches before their images are seen."""

    scenes: list[Scene]
    told: torch.Tensor
    """Shape [B, P - 2]."""
    known: torch.Tensor
    """Shape [B, P - 2]."""


class ToldAhead:
    """Draws what is told on the host, where scenes are.

    Args:
        config: the run.
    """

    def __init__(self, config: RunConfig):
        self.scene, self.seed = config.scene, config.training.seed
        self.table = ToldTable(config.scene)
        self.teller = Teller(config.training.told, self.table)

    def __call__(self, ids: range, values: torch.Tensor) -> ToldPlates:
        """Of samples by their numbers; values of their benches, shape [B, P - 2]."""
        generator = step_generator(self.seed, "told ahead", ids[0], 0, CPU)
        telling = self.teller.drawn(with_camera(values, None), generator)
        believed = filled(*telling, self.table).tolist()
        bench = slice(0, -len(CAMERA))
        return ToldPlates([told_scene(self.scene, each) for each in believed], *(part[:, bench] for part in telling))


class Echoes:
    """Images that answers would make, as a network sees images.

    Args:
        config: the run.
        device: where batches are.
        viewer: of the run.
    """

    def __init__(self, config: RunConfig, device: torch.device, viewer: Viewer):
        self.viewer, self.imager = viewer, BenchImager(config.scene, LATTICE, device)

    @torch.no_grad()
    def __call__(self, seen: Seen, answer: torch.Tensor, scenes: Sequence[Scene]) -> torch.Tensor:
        """Shape [B, n_w, m, m] [W/m^2].

        Args:
            seen: what was answered to.
            answer: in the network's own unit [m], shape [B, n, n].
            scenes: that are told.
        """
        base = seen.values[:, :1, None]
        heights = (answer.float() * seen.scale).nan_to_num(0.0).clamp(max=HIGHEST_RELIEF_M)
        light = self.imager(torch.maximum(heights, -DEEPEST_TRENCH * base), scenes)
        return self.viewer.light.rectified(light / self.viewer.light.level(seen.values), seen.values)


class Feedback:
    """What a pool keeps of the network's own answers.

    Args:
        config: the run.
        device: where batches are.
        rank: which of the processes.
    """

    def __init__(self, config: RunConfig, device: torch.device, rank: int = 0):
        self.config, self.device, self.rank = config, device, rank
        self.options, self.seed = config.training.feedback, config.training.seed
        self.viewer = Viewer(config, device)
        self.echoes = Echoes(config, device, self.viewer)

    def looks(self, round_: int) -> int:
        """How many answers the samples of a round have been given: 0, 1 or 2."""
        unit = step_seed(self.seed, "feedback", round_, self.rank) / 2**63
        return 0 if unit >= self.options.share else 1 + (unit < self.options.share * self.options.twice_share)

    @torch.no_grad()
    def __call__(self, batch: Batch, plates: ToldPlates, round_: int, network: Model | None) -> Batch:
        """Entries of :class:`Given` of a batch; a flat plate where the round has none, or there is no network."""
        count, n = len(batch["image"]), self.config.scene.height_samples
        told, known = (part.to(self.device, non_blocking=True) for part in plates[1:])
        answer = torch.zeros(count, n, n, device=self.device)
        echo = self.viewer.flat.expand_as(batch["image"])
        none = torch.zeros(count, 1, device=self.device)
        given = Given(answer, echo, told, known, none)
        if network is None or not self.looks(round_):
            return given._asdict()

        def generator(purpose: str) -> torch.Generator:
            return step_generator(self.seed, f"feedback {purpose}", round_, self.rank, self.device)

        pictures = self.viewer.pictures.drawn(count, generator("pictures"))
        given = given._replace(is_given=none + 1)  # what is told, from now on
        seen = self.viewer.seen(
            batch["image"], batch["bench"], generator("camera"), generator("told"), pictures=pictures, given=given
        )
        for _ in range(self.looks(round_)):
            answer = seen.answer(network).float()
            given = given._replace(answer=answer, echo=self.echoes(seen, answer, plates.scenes))
            seen = seen._replace(before=(given.answer, self.viewer.pictures.seen(given.echo, pictures)))
        return given._asdict()
