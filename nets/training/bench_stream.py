"""Plates and benches of fresh samples: drawn on the host while the device works, printed on the device."""

from concurrent.futures import Future, ThreadPoolExecutor
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


class OnBenches(NamedTuple):
    """Plates and their benches."""

    heights: torch.Tensor
    """[m], shape [B, n, n], on the device."""
    scenes: list[Scene]
    values: torch.Tensor
    """Parameters of the benches, shape [B, P - 2], on the device."""


class BenchStream:
    """Plates and benches of consecutive batches of samples.

    Args:
        dataset: of captures; gives prints, ranges, scene and keys.
        device: where heights are wanted.
        scene_share: of the samples are on the data set's scene itself.
    """

    def __init__(self, dataset: DatasetConfig, device: torch.device, scene_share: float = 0.0):
        self.dataset, self.device, self.scene_share = dataset, device, scene_share
        self.fingerprint = dataset.sample_fingerprint()
        self.kinds = PrintKinds(dataset, self.fingerprint)
        self.reliefs = [Reliefs(kind, device, self.fingerprint) for kind in self.kinds.datasets]
        self._pool = ThreadPoolExecutor(max_workers=1, thread_name_prefix="benches")
        self._waiting: dict[range, Future[Drawn]] = {}

    def __call__(self, ids: range, following: list[range] | None = None) -> OnBenches:
        """Plates and benches of samples.

        Args:
            ids: their numbers.
            following: batches that will be asked for next.
        """
        found = self._waiting.pop(ids, None)
        drawn = found.result() if found is not None else self._drawn(ids)
        for coming in following or []:
            if coming not in self._waiting:
                self._waiting[coming] = self._pool.submit(self._drawn, coming)
        n = self.dataset.scene.height_samples
        heights = torch.empty(len(ids), n, n, device=self.device)
        for part in drawn.prints:
            printed = self.reliefs[part.kind].printed(part.strokes, part.traits)
            heights[part.rows.to(self.device, non_blocking=True)] = printed
        return OnBenches(heights, drawn.scenes, drawn.values.to(self.device, non_blocking=True))

    def close(self) -> None:
        """End the thread."""
        self._pool.shutdown(wait=True, cancel_futures=True)
        self._waiting.clear()

    def _drawn(self, ids: range) -> Drawn:
        numbers = [self.kinds.number(sample) for sample in ids]
        prints = []
        for kind in sorted(set(numbers)):
            rows = [row for row, number in enumerate(numbers) if number == kind]
            own, reliefs = [ids[row] for row in rows], self.reliefs[kind]
            strokes = torch.from_numpy(padded(reliefs.drawn(own)))
            traits = self._sent(reliefs.traits(own))
            prints.append(Printed(kind, self._sent(torch.tensor(rows)), self._sent(strokes), traits))
        # How they are printed is on record in data sets only.
        unrecorded = dict.fromkeys(PRINT_NAMES, np.zeros(len(ids)))
        scenes = scenes_of(self.dataset.scene, draw_benches(self.dataset, self.fingerprint, ids, unrecorded))
        on_scene = [sample_generator(self.fingerprint, "on the scene", k).random() < self.scene_share for k in ids]
        scenes = [self.dataset.scene if is_on else scene for is_on, scene in zip(on_scene, scenes, strict=True)]
        values = torch.tensor([bench_values(scene) for scene in scenes], dtype=torch.float32)
        return Drawn(prints, scenes, self._sent(values))

    def _sent(self, tensor: torch.Tensor) -> torch.Tensor:
        """In memory from which it reaches the device without anybody waiting."""
        return tensor.pin_memory() if self.device.type == "cuda" else tensor
