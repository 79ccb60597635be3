"""One kind of training: what it minimises, what it is judged by, what it shows; and what all kinds share."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import torch

from nets.encoding import flat_irradiance
from nets.symmetries import draw_symmetries, transformed
from nets.training.batch import Batch
from nets.training.camera import draw_cameras, noisy, seen
from nets.training.config import RunConfig
from nets.training.keys import step_generator

Model = Callable[..., Any]
"""The network as it is called in training: in its precision, on all processes."""


@dataclass(frozen=True)
class Sample:
    """What a sample picture shows.

    Attributes:
        image: what the network saw, shape [n_w, m, m] [W/m^2].
        truth: shape [n, n] [m] for heights, [m, m] [W/m^2] for images.
        answer: of the network, shape of truth.
        is_height: which of both.
    """

    image: torch.Tensor
    truth: torch.Tensor
    answer: torch.Tensor
    is_height: bool

    def on_cpu(self) -> "Sample":
        """The same in the CPU's memory."""
        return Sample(self.image.cpu(), self.truth.cpu(), self.answer.cpu(), self.is_height)


class Task(Protocol):
    """One kind of training."""

    objective: str
    """Name of the measure that is minimised over epochs."""

    def loss(self, model: Model, batch: Batch, step: int, progress: float) -> torch.Tensor:
        """Scalar to minimise; ``progress`` runs from 0 to 1 over the whole run."""

    def measures(self, model: Model, batches: list[Batch]) -> dict[str, float]:
        """Quality on validation batches."""

    def sample(self, model: Model, batch: Batch) -> Sample:
        """The first sample of a validation batch, to be looked at."""


class Common:
    """What all kinds share.

    Args:
        config: the run.
        device: where batches are.
        rank: which of the processes.
    """

    def __init__(self, config: RunConfig, device: torch.device, rank: int = 0):
        self.config, self.training, self.device, self.rank = config, config.training, device, rank
        self.flat = flat_irradiance(config.scene).to(device)

    def generator(self, purpose: str, step: int) -> torch.Generator:
        return step_generator(self.training.seed, purpose, step, self.rank, self.device)

    def turned(self, batch: Batch, step: int) -> Batch:
        """The batch under random symmetries."""
        if not self.training.augmentation.symmetries:
            return batch
        size = len(next(iter(batch.values())))
        symmetries = draw_symmetries(size, self.config.scene, self.generator("symmetries", step))
        return {name: transformed(values, symmetries) for name, values in batch.items()}

    def seen(self, image: torch.Tensor, step: int) -> torch.Tensor:
        """The image as a camera sees it."""
        return self._through_camera(image, self.generator("camera", step))

    def validation_image(self, batch: Batch, number: int) -> torch.Tensor:
        """The image of a validation batch with its noise, the same in every epoch and run."""
        validation = self.training.validation
        generator = step_generator(validation.seed, "noise", number, 0, self.device)
        return noisy(batch["image"], self.flat, validation.noise, generator)

    def varied_validation_image(self, batch: Batch, number: int) -> torch.Tensor:
        """The image of a validation batch through cameras like those of the training, the same in every epoch."""
        if self.training.camera is None:
            return self.validation_image(batch, number)
        generator = step_generator(self.training.validation.seed, "camera", number, 0, self.device)
        return self._through_camera(batch["image"], generator)

    def _through_camera(self, image: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
        if self.training.camera is None:
            return image
        cameras = draw_cameras(self.training.camera, len(image), image.shape[1], generator)
        return seen(image, self.flat, cameras, generator)


def relief_measures(errors: list[torch.Tensor]) -> dict[str, float]:
    """Mean and median over fields of the relief's RMSE [um]."""
    rmse = torch.cat(errors)
    return {"val_rmse_um": float(rmse.mean()), "val_median_rmse_um": float(rmse.median())}
