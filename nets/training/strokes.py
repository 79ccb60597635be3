"""Printed reliefs of fresh samples, drawn ahead of time in a thread."""

from concurrent.futures import Future, ThreadPoolExecutor

import torch

from data_gen.dataset_config import DatasetConfig, sample_generator
from data_gen.patterns import draw_strokes, padded, perturb_strokes
from data_gen.reliefs import print_strokes, traits_of

AHEAD = 4
"""Batches drawn in advance."""


class StrokeStream:
    """Reliefs of consecutive batches of samples.

    Strokes are drawn on the CPU (tens of microseconds each) while the device
    works on the batches before, and printed on the device. Same samples as
    :class:`data_gen.samples.Reliefs`.

    Args:
        dataset: gives pattern, scene and keys.
        device: where heights are wanted.
        with_start: also print the perturbed strokes.
    """

    def __init__(self, dataset: DatasetConfig, device: torch.device, *, with_start: bool):
        self.dataset, self.device, self.with_start = dataset, device, with_start
        self.fingerprint = dataset.sample_fingerprint()
        self._pool = ThreadPoolExecutor(max_workers=1, thread_name_prefix="strokes")
        self._waiting: dict[range, Future[list[torch.Tensor]]] = {}

    def reliefs(self, ids: range, following: list[range] | None = None) -> list[torch.Tensor]:
        """Heights [m], shape [len(ids), n, n], of the true relief and, where wanted, of the perturbed one.

        Args:
            ids: sample numbers.
            following: batches that will be asked for next.
        """
        found = self._waiting.pop(ids, None)
        drawn = found.result() if found is not None else self._drawn(ids)
        for coming in following or []:
            if coming not in self._waiting:
                self._waiting[coming] = self._pool.submit(self._drawn, coming)
        pattern, scene = self.dataset.reliefs, self.dataset.scene
        traits, *sets = drawn
        return [print_strokes(strokes.to(self.device, non_blocking=True), scene, pattern, traits) for strokes in sets]

    def close(self) -> None:
        """End the thread."""
        self._pool.shutdown(wait=True, cancel_futures=True)
        self._waiting.clear()

    def _drawn(self, ids: range) -> list[torch.Tensor]:
        """Traits, strokes and, where wanted, perturbed strokes."""
        pattern, key = self.dataset.reliefs, self.fingerprint
        true = [draw_strokes(pattern, sample_generator(key, "relief", sample)) for sample in ids]
        sets = [true]
        if self.with_start:
            sets.append(
                [
                    perturb_strokes(strokes, pattern, sample_generator(key, "perturbation", sample))[0]
                    for strokes, sample in zip(true, ids, strict=True)
                ]
            )
        tensors = [traits_of(self.dataset, key, ids), *(torch.from_numpy(padded(strokes)) for strokes in sets)]
        return [tensor.pin_memory() for tensor in tensors] if self.device.type == "cuda" else tensors
