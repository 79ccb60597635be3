"""Plates and benches of fresh samples: drawn on the host while the device works, printed on the device."""

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
import torch

from data_gen.benches.columns import PRINT_NAMES
from data_gen.benches.draw import draw_benches, scenes_of
from data_gen.benches.prints import PrintKinds
from data_gen.dataset_config import DatasetConfig, sample_generator
from data_gen.patterns import padded
from data_gen.samples import Reliefs
from nets.told import bench_values
from nets.training.drawn_ahead import DrawnAhead, sendable
from nets.training.feedback import ToldPlates
from warp_caustics.scene import Scene


class Printed(NamedTuple):
    """Samples of a batch that are of one kind of prints, on the host."""

    kind: int
    rows: torch.Tensor
    """Their places in the batch."""
    strokes: torch.Tensor
    traits: torch.Tensor


class Drawn(NamedTuple):
    """A batch before anything is computed on the device."""

    prints: list[Printed]
    scenes: list[Scene]
    values: torch.Tensor
    """Parameters of the benches, shape [B, P - 2], see :mod:`nets.told`."""
    told: ToldPlates | None = None


class OnBenches(NamedTuple):
    """Plates and their benches."""

    heights: torch.Tensor
    """[m], shape [B, n, n], on the device."""
    scenes: list[Scene]
    values: torch.Tensor
    """Parameters of the benches, shape [B, P - 2], on the device."""
    told: ToldPlates | None = None
    """What is told of them, on the host; None where nobody asked for it."""


class BenchStream:
    """Plates and benches of consecutive batches of samples.

    Args:
        dataset: of captures; gives prints, ranges, scene and keys.
        device: where heights are wanted.
        scene_share: of the samples are on the data set's scene itself.
        tell: draws what is told of benches by sample numbers and parameters; None draws nothing.
    """

    def __init__(
        self,
        dataset: DatasetConfig,
        device: torch.device,
        scene_share: float = 0.0,
        tell: Callable[[range, torch.Tensor], ToldPlates] | None = None,
    ):
        self.dataset, self.device, self.scene_share, self.tell = dataset, device, scene_share, tell
        self.fingerprint = dataset.sample_fingerprint()
        self.kinds = PrintKinds(dataset, self.fingerprint)
        self.reliefs = [Reliefs(kind, device, self.fingerprint) for kind in self.kinds.datasets]
        self._ahead = DrawnAhead(self._drawn)

    def __call__(self, ids: range, following: Iterable[range] = ()) -> OnBenches:
        """Plates and benches of samples.

        Args:
            ids: their numbers.
            following: batches that will be asked for next.
        """
        drawn = self._ahead(ids, following)
        n = self.dataset.scene.height_samples
        heights = torch.empty(len(ids), n, n, device=self.device)
        for part in drawn.prints:
            printed = self.reliefs[part.kind].printed(part.strokes, part.traits)
            heights[part.rows.to(self.device, non_blocking=True)] = printed
        return OnBenches(heights, drawn.scenes, drawn.values.to(self.device, non_blocking=True), drawn.told)

    def close(self) -> None:
        """End the thread."""
        self._ahead.close()

    def _drawn(self, ids: range) -> Drawn:
        numbers = [self.kinds.number(sample) for sample in ids]
        prints = []
        for kind in sorted(set(numbers)):
            rows = [row for row, number in enumerate(numbers) if number == kind]
            own, reliefs = [ids[row] for row in rows], self.reliefs[kind]
            strokes = torch.from_numpy(padded(reliefs.drawn(own)))
            parts = (torch.tensor(rows), strokes, reliefs.traits(own))
            prints.append(Printed(kind, *(sendable(part, self.device) for part in parts)))
        # How they are printed is on record in data sets only.
        unrecorded = dict.fromkeys(PRINT_NAMES, np.zeros(len(ids)))
        scenes = scenes_of(self.dataset.scene, draw_benches(self.dataset, self.fingerprint, ids, unrecorded))
        on_scene = [sample_generator(self.fingerprint, "on the scene", k).random() < self.scene_share for k in ids]
        scenes = [self.dataset.scene if is_on else scene for is_on, scene in zip(on_scene, scenes, strict=True)]
        values = torch.tensor([bench_values(scene) for scene in scenes], dtype=torch.float32)
        told = None if self.tell is None else self.tell(ids, values)
        if told is not None:
            told = ToldPlates(told.scenes, *(sendable(part, self.device) for part in told[1:]))
        return Drawn(prints, scenes, sendable(values, self.device), told)
