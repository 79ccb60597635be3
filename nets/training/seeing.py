"""What a network that is told of its bench is given: images through cameras, and what somebody knows of both."""

from typing import NamedTuple

import torch

from nets.encoding import flat_irradiance
from nets.flat_light import FlatLight
from nets.told import CAMERA, ToldTable, dropped, filled
from nets.training.batch import Batch
from nets.training.camera import draw_cameras, seen
from nets.training.config import RunConfig
from nets.training.pictures import PictureMaker, Pictures
from nets.training.task import Model
from nets.training.telling import Teller, Telling, with_camera


class Given(NamedTuple):
    """An earlier answer of the network, and what was told when it was found."""

    answer: torch.Tensor
    """[m], in the network's own unit (:meth:`nets.flat_light.FlatLight.height_scale`), shape [B, n, n]."""
    echo: torch.Tensor
    """The image that it would make, as the network sees images, shape [B, n_w, m, m] [W/m^2]."""
    told: torch.Tensor
    """Of the scene, shape [B, P - 2]."""
    known: torch.Tensor
    """Shape [B, P - 2]."""
    is_given: torch.Tensor
    """1, or 0 where the answer is flat and nothing was told yet, shape [B, 1]."""

    @classmethod
    def of(cls, batch: Batch) -> "Given | None":
        """Of a batch; None where it has none."""
        return cls(*(batch[name] for name in cls._fields)) if "echo" in batch else None


class Seen(NamedTuple):
    """What a network is given of a batch."""

    image: torch.Tensor
    told: torch.Tensor
    scale: torch.Tensor
    """Of its answers, see :meth:`nets.flat_light.FlatLight.height_scale`; shape [B, 1, 1]."""
    values: torch.Tensor
    """What is told, with the scene's in place of what is not, shape [B, P]."""
    before: tuple[torch.Tensor, ...] = ()
    """An earlier answer and its echo; empty for none."""

    def answered(self, model: Model) -> torch.Tensor:
        """Heights [m], shape [B, n, n]."""
        return self.answer(model) * self.scale

    def answer(self, model: Model) -> torch.Tensor:
        """The same in the network's own unit."""
        heights: torch.Tensor = model(self.image, self.told, *self.before)
        return heights


class Viewer:
    """Shows a network its images.

    The picture is moved and the answer scaled by what is told (:mod:`nets.flat_light`), errors and all, as a
    reconstruction does; where light, base, gap or glass are unknown, by what the run's scene says of them.

    Args:
        config: the run.
        device: where batches are.
    """

    def __init__(self, config: RunConfig, device: torch.device):
        self.camera = config.training.camera
        self.flat = flat_irradiance(config.scene).to(device)
        self.table = ToldTable(config.scene, device)
        self.light, self.teller = FlatLight(self.table), Teller(config.training.told, self.table)
        self.pictures = PictureMaker(config.training.pictures, self.table, self.flat)

    def seen(
        self,
        image: torch.Tensor,
        bench: torch.Tensor,
        camera: torch.Generator,
        told: torch.Generator | None,
        known: torch.Tensor | None = None,
        pictures: Pictures | None = None,
        given: Given | None = None,
    ) -> Seen:
        """Images through cameras, moved by what is told.

        Args:
            image: shape [B, n_w, m, m] [W/m^2].
            bench: its parameters, shape [B, P - 2].
            camera: of cameras and noise.
            told: of what is told; None tells what is true.
            known: where what is true is told, shape [B, P]; None for nowhere.
            pictures: which images have fewer wavelengths or pixels; None for none.
            given: an earlier answer; what is told of the scene is then what was told for that.
        """
        cameras = None if self.camera is None else draw_cameras(self.camera, len(image), image.shape[1], camera)
        known_camera = None if cameras is None else self.pictures.blurs(cameras, pictures)
        true = with_camera(self.pictures.bench(bench, pictures), known_camera)
        if told is not None:
            telling = self.teller.drawn(true, told)
        else:
            telling = Telling(true, torch.zeros_like(true) if known is None else known)
        if given is not None:
            telling = self._as_before(telling, given, pictures)
        values = filled(*telling, self.table)
        if cameras is None:
            image = self.light.rectified(image, values)
        else:
            cameras = self.pictures.noises(cameras, pictures)
            image = seen(image, self.flat, cameras, camera, self.light.places(values))
        before = () if given is None else (given.answer, self.pictures.seen(given.echo, pictures))
        return Seen(
            self.pictures.seen(image, pictures),
            dropped(*telling, self.table),
            self.light.height_scale(values),
            values,
            before,
        )

    def _as_before(self, telling: Telling, given: Given, pictures: Pictures | None) -> Telling:
        """What was told of the scenes before, where an answer is given; of cameras what is told now."""
        scene, is_given = slice(0, -len(CAMERA)), given.is_given > 0
        values, known = telling.values.clone(), telling.known.clone()
        values[:, scene] = torch.where(is_given, self.pictures.bench(given.told, pictures), values[:, scene])
        known[:, scene] = torch.where(is_given, given.known, known[:, scene])
        return Telling(values, known)
