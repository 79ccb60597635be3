"""What is learned: loss, measure of quality and sample picture of each kind of training."""

from functools import cached_property
from typing import Any

import torch

from data_gen.samples import UpdaterSampler
from nets.training.batch import Batch
from nets.training.config import RunConfig
from nets.training.devices import Stopwatch
from nets.training.keys import fresh_dataset
from nets.training.losses import psnr_db, relief_loss, relief_rmse_um, update_loss
from nets.training.task import Common, Model, Sample, Task, relief_measures
from nets.training.told_task import ToldTask
from nets.training.unrolling import UnrolledTask
from nets.training.weights import frozen_denoiser
from warp_caustics.data_gradient import possible_heights

ITERATED_STEPS = 10
"""Of the paper's reconstructions."""


class DenoiserTask(Common):
    """Noisy to clean images, mean square error (section 2.1)."""

    objective = "val_loss"

    def loss(self, model: Model, batch: Batch, step: int, progress: float) -> torch.Tensor:
        batch = self.turned(batch, step)
        error = (model(batch["noisy"]) - batch["clean"]) / self.flat
        loss: torch.Tensor = error.square().mean()
        return loss

    def measures(self, model: Model, batches: list[Batch]) -> dict[str, float]:
        """Mean square error and PSNR; their peak is the light of a flat plate."""
        losses, before, after = [], [], []
        for batch in batches:
            clean = batch["clean"] / self.flat
            answer = model(batch["noisy"]) / self.flat
            losses.append((answer - clean).square().mean(dim=(1, 2, 3)))
            after.append(psnr_db(answer, clean, 1.0).mean(dim=1))
            before.append(psnr_db(batch["noisy"] / self.flat, clean, 1.0).mean(dim=1))
        names = ("val_loss", "val_psnr_db", "val_noisy_psnr_db")
        return {n: float(torch.cat(v).mean()) for n, v in zip(names, (losses, after, before), strict=True)}

    def sample(self, model: Model, batch: Batch) -> Sample:
        answer = model(batch["noisy"][:1])[0, 0]
        return Sample(batch["noisy"][0], batch["clean"][0, 0], answer, is_height=False)


class UpdaterTask(Common):
    """One step from perturbed heights to the true ones (section 2.2).

    With starts of its own making it is judged by what it is for: the error after ten steps from a flat plate.
    """

    def __init__(self, config: RunConfig, device: torch.device, rank: int = 0):
        super().__init__(config, device, rank)
        self.is_iterated = config.training.replay.own_share > 0
        self.objective = "val_iterated_rmse_um" if self.is_iterated else "val_loss"

    def loss(self, model: Model, batch: Batch, step: int, progress: float) -> torch.Tensor:
        batch = self.turned(batch, step)
        return self._error(self._heights(model, batch), batch)

    def measures(self, model: Model, batches: list[Batch]) -> dict[str, float]:
        losses, errors, start = [], [], []
        for batch in batches:
            heights = self._heights(model, batch)
            losses.append(float(self._error(heights, batch)) * len(heights))
            errors.append(relief_rmse_um(heights, batch["heights"]))
            start.append(relief_rmse_um(batch["start"], batch["heights"]))
        count = sum(map(len, errors))
        return {
            "val_loss": sum(losses) / count,
            **relief_measures(errors),
            "val_start_rmse_um": float(torch.cat(start).mean()),
            **({"val_iterated_rmse_um": self._iterated_error(model, batches[0])} if self.is_iterated else {}),
        }

    @cached_property
    def _sampler(self) -> UpdaterSampler:
        denoiser, content_hash = frozen_denoiser(self.config, self.device)
        dataset = fresh_dataset(self.config, is_validation=True, denoiser=content_hash)
        return UpdaterSampler(dataset, self.device, denoiser)

    def _iterated_error(self, model: Model, batch: Batch) -> float:
        """Mean RMSE [um] of the fields of a batch, from flat after as many steps as a reconstruction does."""
        size = len(batch["heights"])
        heights = torch.zeros_like(batch["heights"])
        for step in range(ITERATED_STEPS):
            ids = range(step * size, (step + 1) * size)
            at = self._sampler.at(batch["heights"], possible_heights(heights, self.config.scene), batch["target"], ids)
            heights = self._heights(model, at)
        return float(relief_rmse_um(heights, batch["heights"]).mean())

    def sample(self, model: Model, batch: Batch) -> Sample:
        first = {name: values[:1] for name, values in batch.items()}
        return Sample(first["target"][0], first["heights"][0], self._heights(model, first)[0], is_height=True)

    def _heights(self, model: Model, batch: Batch) -> torch.Tensor:
        answer: Any = model(batch["target"], batch["simulated"], batch["start"], batch["gradient"])
        heights: torch.Tensor = answer
        return heights

    def _error(self, heights: torch.Tensor, batch: Batch) -> torch.Tensor:
        return update_loss(heights, batch["heights"], self.training.height_loss, self.training.lambda_tv)


class DirectTask(Common):
    """Image to heights at once."""

    objective = "val_rmse_um"

    def loss(self, model: Model, batch: Batch, step: int, progress: float) -> torch.Tensor:
        batch = self.turned(batch, step)
        heights = model(self.seen(batch["image"], step))
        return relief_loss(heights, batch["heights"], self.config.scene.sample_pitch_m, self.training.slope_weight)

    def measures(self, model: Model, batches: list[Batch]) -> dict[str, float]:
        """Errors through cameras, which decide, and without."""
        varied, perfect = (
            [relief_rmse_um(model(image(batch, number)), batch["heights"]) for number, batch in enumerate(batches)]
            for image in (self.varied_validation_image, self.validation_image)
        )
        return {**relief_measures(varied), "val_perfect_rmse_um": float(torch.cat(perfect).mean())}

    def sample(self, model: Model, batch: Batch) -> Sample:
        image = self.varied_validation_image(batch, 0)[:1]
        return Sample(image[0], batch["heights"][0], model(image)[0], is_height=True)


def make_task(config: RunConfig, device: torch.device, rank: int, watch: Stopwatch) -> Task:
    """The task of a run; ``watch`` times what it simulates itself."""
    if config.kind == "denoiser":
        return DenoiserTask(config, device, rank)
    if config.kind == "updater":
        return UpdaterTask(config, device, rank)
    if config.kind == "direct":
        return (DirectTask if config.training.bench is None else ToldTask)(config, device, rank)
    return UnrolledTask(config, device, rank, watch)
