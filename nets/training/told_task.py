"""Image and what is told of its bench to heights."""

from collections.abc import Callable, Mapping

import torch

from nets.symmetries import draw_symmetries, transformed
from nets.told import dropped, turned
from nets.told_scene import told_scene
from nets.training.batch import Batch
from nets.training.camera import noisy
from nets.training.config import RunConfig, network_feedback
from nets.training.feedback import Echoes
from nets.training.keys import step_generator
from nets.training.losses import relief_loss, relief_rmse_um
from nets.training.seeing import Given, Seen, Viewer
from nets.training.task import Common, Model, Sample, relief_measures
from nets.training.telling import with_camera

BENCHES = ("bench", "told", "known")
"""Entries of a batch that turn as benches do."""


class ToldTask(Common):
    """``direct`` on benches that differ.

    Each sees its image through a camera of its own and is told something of its bench (:mod:`nets.training.seeing`);
    with ``network.feedback`` half of them are given an answer of the network besides (:mod:`nets.training.feedback`).
    """

    objective = "val_rmse_um"

    def __init__(self, config: RunConfig, device: torch.device, rank: int = 0):
        super().__init__(config, device, rank)
        self.viewer = Viewer(config, device)
        self.table, self.light, self.pictures = self.viewer.table, self.viewer.light, self.viewer.pictures
        self.echoes = Echoes(config, device, self.viewer) if network_feedback(config) else None

    def loss(self, model: Model, batch: Batch, step: int, progress: float) -> torch.Tensor:
        batch = self.turned(batch, step)
        cameras, told = self.generator("camera", step), self.generator("told", step)
        pictures = self.pictures.drawn(len(batch["image"]), self.generator("pictures", step))
        given = Given.of(batch)
        seen = self.viewer.seen(batch["image"], batch["bench"], cameras, told, pictures=pictures, given=given)
        return relief_loss(
            seen.answered(model), batch["heights"], self.config.scene.sample_pitch_m, self.training.slope_weight
        )

    def turned(self, batch: Batch, step: int) -> Batch:
        """The batch under random symmetries, benches with their plates."""
        if not self.training.augmentation.symmetries:
            return batch
        symmetries = draw_symmetries(len(batch["bench"]), self.config.scene, self.generator("symmetries", step))

        def seen(name: str, values: torch.Tensor) -> torch.Tensor:
            if name == "is_given":
                return values
            return turned(values, symmetries, self.table) if name in BENCHES else transformed(values, symmetries)

        return {name: seen(name, values) for name, values in batch.items()}

    def measures(self, model: Model, batches: list[Batch]) -> dict[str, float]:
        """Errors on benches that are told with errors, which decide, or not at all; and on the run's scene, told."""

        def errors(images: list[Seen]) -> list[torch.Tensor]:
            pairs = zip(images, batches, strict=True)
            return [relief_rmse_um(given.answered(model), batch["heights"]) for given, batch in pairs]

        def mean(images: list[Seen]) -> float:
            return float(torch.cat(errors(images)).mean())

        numbered = list(enumerate(batches))
        return {
            **relief_measures(errors([self._told(batch, number) for number, batch in numbered])),
            "val_unknown_rmse_um": mean([self._untold(batch, number) for number, batch in numbered]),
            "val_default_rmse_um": mean([self._default(batch, number) for number, batch in numbered]),
            "val_perfect_rmse_um": mean([self._perfect(batch, number) for number, batch in numbered]),
            **{
                name: mean([self._told(batch, number, kind) for number, batch in numbered])
                for name, kind in self._others().items()
            },
            **self._second(model, numbered),
        }

    def looks(self, batch: Batch, number: int) -> dict[str, Seen]:
        """A validation batch in each way in which benches are judged, the same in every epoch and run.

        Told as in training, told exactly, told nothing; on the run's scene, through cameras and without.
        """
        return {
            "told": self._told(batch, number),
            "exact": self._exact(batch, number),
            "unknown": self._untold(batch, number),
            "default": self._default(batch, number),
            "perfect": self._perfect(batch, number),
        }

    def _second(self, model: Model, batches: list[tuple[int, Batch]]) -> dict[str, float]:
        """Errors of a second look, at the answer of the first: told with errors, and on the run's scene."""
        if self.echoes is None:
            return {}
        echoes = self.echoes

        def mean(look: Callable[[Batch, int], Seen]) -> float:
            errors = []
            for number, batch in batches:
                first = look(batch, number)
                answer = first.answer(model).float()
                scenes = [told_scene(self.config.scene, values) for values in first.values.tolist()]
                second = first._replace(before=(answer, echoes(first, answer, scenes)))
                errors.append(relief_rmse_um(second.answered(model), batch["heights"]))
            return float(torch.cat(errors).mean())

        return {"val_second_rmse_um": mean(self._told), "val_default_second_rmse_um": mean(self._default)}

    def _others(self) -> dict[str, dict[str, bool]]:
        """Measures of pictures of fewer wavelengths or pixels, where the training has such."""
        options, found = self.training.pictures, {}
        if options.one_wavelength_share:
            found["val_one_wavelength_rmse_um"] = {"is_one": True}
        if options.coarse_share:
            found["val_coarse_rmse_um"] = {"is_coarse": True}
        return found

    def sample(self, model: Model, batch: Batch) -> Sample:
        image, told, scale, values, _ = self._told(batch, 0)
        first = Seen(image[:1], told[:1], scale[:1], values[:1])
        return Sample(first.image[0], batch["heights"][0], first.answered(model)[0], is_height=True)

    def _told(self, batch: Batch, number: int, kind: Mapping[str, bool] | None = None) -> Seen:
        """A validation batch as trained on, the same in every epoch; all pictures of the scene, or all of one kind."""
        pictures = None if kind is None else self.pictures.fixed(len(batch["image"]), **kind)
        cameras, told = self._fixed("camera", number), self._fixed("told", number)
        return self.viewer.seen(batch["image"], batch["bench"], cameras, told, pictures=pictures)

    def _untold(self, batch: Batch, number: int) -> Seen:
        """The same images, with nothing told."""
        return self.viewer.seen(batch["image"], batch["bench"], self._fixed("camera", number), None)

    def _exact(self, batch: Batch, number: int) -> Seen:
        """The same images, with all told as it is, cameras too."""
        known = torch.ones(len(batch["bench"]), len(self.table), device=self.device)
        return self.viewer.seen(batch["image"], batch["bench"], self._fixed("camera", number), None, known)

    def _default(self, batch: Batch, number: int) -> Seen:
        """The same plates on the run's scene, told all but the blur; the same cameras."""
        bench = self._scene(batch)
        return self.viewer.seen(
            batch["default_image"], bench, self._fixed("camera", number), None, self._but_blur(bench)
        )

    def _perfect(self, batch: Batch, number: int) -> Seen:
        """The same plates on the run's scene through perfect cameras, with noise."""
        noise = self.training.validation.noise
        image = noisy(batch["default_image"], self.flat, noise, self._fixed("noise", number))
        true = with_camera(self._scene(batch), None)
        true[:, -1] = noise
        known = self._but_blur(true[:, :-2])
        return Seen(image, dropped(true, known, self.table), self.light.height_scale(true), true)

    def _scene(self, batch: Batch) -> torch.Tensor:
        """Parameters of the run's scene for each sample, shape [B, P - 2]."""
        return self.table.centre[None, :-2].expand(len(batch["bench"]), -1)

    def _but_blur(self, bench: torch.Tensor) -> torch.Tensor:
        """All is known but the blur, shape [B, P]."""
        known = torch.ones(len(bench), len(self.table), device=bench.device)
        known[:, self.table.place("blur_px")] = 0.0
        return known

    def _fixed(self, purpose: str, number: int) -> torch.Generator:
        return step_generator(self.training.validation.seed, purpose, number, 0, self.device)
