"""Image and what is told of its bench to heights."""

from collections.abc import Mapping
from typing import NamedTuple

import torch

from nets.flat_light import FlatLight
from nets.symmetries import draw_symmetries, transformed
from nets.told import ToldTable, dropped, filled, turned
from nets.training.batch import Batch
from nets.training.camera import draw_cameras, noisy, seen
from nets.training.config import RunConfig
from nets.training.keys import step_generator
from nets.training.losses import relief_loss, relief_rmse_um
from nets.training.pictures import PictureMaker, Pictures
from nets.training.task import Common, Model, Sample, relief_measures
from nets.training.telling import Teller, Telling, with_camera


class Seen(NamedTuple):
    """What a network is given of a batch."""

    image: torch.Tensor
    told: torch.Tensor
    scale: torch.Tensor
    """Of its answers, see :meth:`nets.flat_light.FlatLight.height_scale`; shape [B, 1, 1]."""

    def answered(self, model: Model) -> torch.Tensor:
        """Heights [m], shape [B, n, n]."""
        heights: torch.Tensor = model(self.image, self.told) * self.scale
        return heights


class ToldTask(Common):
    """``direct`` on benches that differ.

    The picture is moved and the answer scaled by what is told (:mod:`nets.flat_light`), errors and all, as a
    reconstruction does; where light, base, gap or glass are unknown, by what the run's scene says of them.
    """

    objective = "val_rmse_um"

    def __init__(self, config: RunConfig, device: torch.device, rank: int = 0):
        super().__init__(config, device, rank)
        self.table = ToldTable(config.scene, device)
        self.light, self.teller = FlatLight(self.table), Teller(config.training.told, self.table)
        self.pictures = PictureMaker(config.training.pictures, self.table, self.flat)

    def loss(self, model: Model, batch: Batch, step: int, progress: float) -> torch.Tensor:
        batch = self.turned(batch, step)
        cameras, told = self.generator("camera", step), self.generator("told", step)
        pictures = self.pictures.drawn(len(batch["image"]), self.generator("pictures", step))
        heights = self._seen(batch["image"], batch["bench"], cameras, told, pictures=pictures).answered(model)
        return relief_loss(heights, batch["heights"], self.config.scene.sample_pitch_m, self.training.slope_weight)

    def turned(self, batch: Batch, step: int) -> Batch:
        """The batch under random symmetries, benches with their plates."""
        if not self.training.augmentation.symmetries:
            return batch
        symmetries = draw_symmetries(len(batch["bench"]), self.config.scene, self.generator("symmetries", step))
        maps = {name: transformed(values, symmetries) for name, values in batch.items() if name != "bench"}
        return {**maps, "bench": turned(batch["bench"], symmetries, self.table)}

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
        }

    def _others(self) -> dict[str, dict[str, bool]]:
        """Measures of pictures of fewer wavelengths or pixels, where the training has such."""
        options, found = self.training.pictures, {}
        if options.one_wavelength_share:
            found["val_one_wavelength_rmse_um"] = {"is_one": True}
        if options.coarse_share:
            found["val_coarse_rmse_um"] = {"is_coarse": True}
        return found

    def sample(self, model: Model, batch: Batch) -> Sample:
        first = Seen(*(part[:1] for part in self._told(batch, 0)))
        return Sample(first.image[0], batch["heights"][0], first.answered(model)[0], is_height=True)

    def _told(self, batch: Batch, number: int, kind: Mapping[str, bool] | None = None) -> Seen:
        """A validation batch as trained on, the same in every epoch; all pictures of the scene, or all of one kind."""
        pictures = None if kind is None else self.pictures.fixed(len(batch["image"]), **kind)
        cameras, told = self._fixed("camera", number), self._fixed("told", number)
        return self._seen(batch["image"], batch["bench"], cameras, told, pictures=pictures)

    def _untold(self, batch: Batch, number: int) -> Seen:
        """The same images, with nothing told."""
        return self._seen(batch["image"], batch["bench"], self._fixed("camera", number), None)

    def _default(self, batch: Batch, number: int) -> Seen:
        """The same plates on the run's scene, told all but the blur; the same cameras."""
        bench = self._scene(batch)
        return self._seen(batch["default_image"], bench, self._fixed("camera", number), None, self._but_blur(bench))

    def _perfect(self, batch: Batch, number: int) -> Seen:
        """The same plates on the run's scene through perfect cameras, with noise."""
        noise = self.training.validation.noise
        image = noisy(batch["default_image"], self.flat, noise, self._fixed("noise", number))
        true = with_camera(self._scene(batch), None)
        true[:, -1] = noise
        known = self._but_blur(true[:, :-2])
        return Seen(image, dropped(true, known, self.table), self.light.height_scale(true))

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

    def _seen(
        self,
        image: torch.Tensor,
        bench: torch.Tensor,
        camera: torch.Generator,
        told: torch.Generator | None,
        known: torch.Tensor | None = None,
        pictures: Pictures | None = None,
    ) -> Seen:
        """Images through cameras, moved by what is told.

        Args:
            image: shape [B, n_w, m, m] [W/m^2].
            bench: its parameters, shape [B, P - 2].
            camera: of cameras and noise.
            told: of what is told; None tells what is true.
            known: where what is true is told, shape [B, P]; None for nowhere.
            pictures: which images have fewer wavelengths or pixels; None for none.
        """
        options = self.training.camera
        cameras = None if options is None else draw_cameras(options, len(image), image.shape[1], camera)
        known_camera = None if cameras is None else self.pictures.blurs(cameras, pictures)
        true = with_camera(self.pictures.bench(bench, pictures), known_camera)
        if told is not None:
            telling = self.teller.drawn(true, told)
        else:
            telling = Telling(true, torch.zeros_like(true) if known is None else known)
        values = filled(*telling, self.table)
        if cameras is None:
            image = self.light.rectified(image, values)
        else:
            cameras = self.pictures.noises(cameras, pictures)
            image = seen(image, self.flat, cameras, camera, self.light.places(values))
        return Seen(self.pictures.seen(image, pictures), dropped(*telling, self.table), self.light.height_scale(values))
