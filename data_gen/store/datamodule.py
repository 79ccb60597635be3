"""A built data set for trainings with PyTorch Lightning; ``nsfc train`` reads files without its trainer."""

from collections.abc import Iterable
from typing import Any

import lightning
from torch.utils.data import DataLoader

from data_gen.store.reader import CausticDataset
from warp_caustics.io.atomic import PathLike


class CausticDataModule(lightning.LightningDataModule):
    """Training and validation loaders of a data set, split 90/10 by a hash of the sample's number.

    A batch is a dictionary of tensors, one per field, and the samples' numbers as ``"id"``.

    Args:
        directory: the data set's folder.
        fields: names of the arrays to read; all if None.
        batch_size: samples per batch.
        workers: processes that read; spawned, because HDF5 and CUDA do not survive a fork.
        val_fraction: share of the validation samples.
    """

    def __init__(
        self,
        directory: PathLike,
        fields: Iterable[str] | None = None,
        *,
        batch_size: int = 16,
        workers: int = 0,
        val_fraction: float = 0.1,
    ) -> None:
        super().__init__()
        self.directory, self.fields = directory, None if fields is None else tuple(fields)
        self.batch_size, self.workers, self.val_fraction = batch_size, workers, val_fraction
        self.training_set: CausticDataset | None = None
        self.validation_set: CausticDataset | None = None

    def setup(self, stage: str | None = None) -> None:
        """Open the data set; each process its own.

        Raises:
            MismatchError: it is unfinished.
            DamagedDataError: files are missing or broken.
        """
        options: dict[str, Any] = {"val_fraction": self.val_fraction}
        self.training_set = CausticDataset(self.directory, self.fields, split="train", **options)
        self.validation_set = CausticDataset(self.directory, self.fields, split="val", **options)

    def train_dataloader(self) -> DataLoader[Any]:
        """Shuffled batches of the training part."""
        return self._loader(self.training_set, shuffle=True)

    def val_dataloader(self) -> DataLoader[Any]:
        """Batches of the validation part, in order."""
        return self._loader(self.validation_set, shuffle=False)

    def _loader(self, part: CausticDataset | None, shuffle: bool) -> DataLoader[Any]:
        assert part is not None, "setup comes first"
        return DataLoader(
            part,
            batch_size=self.batch_size,
            shuffle=shuffle,
            num_workers=self.workers,
            multiprocessing_context="spawn" if self.workers else None,
            persistent_workers=self.workers > 0,
        )
