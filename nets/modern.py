"""This project's own networks: image to heights at once, and a learned step of an iterative scheme.

Both turn images to the resolution of the height map by moving the m/n x m/n
pixels above a height sample into channels, so nothing is lost, and run one
:class:`nets.backbone.Backbone`. Inputs and outputs are physical quantities in
SI units and float32; under autocast only the backbone runs in lower precision.
"""

from typing import NamedTuple

import torch
from torch import nn
from torch.nn import functional

from nets.backbone import Backbone, group_norm, zeroed
from nets.encoding import clipped_image, flat_irradiance, full_precision, log_image, scaled_gradient, slopes
from nets.modern_config import DirectConfig, UnrolledConfig
from nets.padding import resolution_ratio
from warp_caustics.errors import MismatchError
from warp_caustics.scene import Scene


class Update(NamedTuple):
    """One step of an iterative scheme."""

    heights: torch.Tensor
    """Improved heights, shape [B, n, n] [m]."""
    hidden: torch.Tensor | None
    """Memory for the next step, shape [B, c, n, n]; None for a network without."""


class Head(nn.Module):
    """Normalise, SiLU, 3 x 3 convolution, always in float32; shape [B, c_in, n, n] -> [B, c_out, n, n].

    Starts at zero. bfloat16 would round a height of 2 mm by up to 4 um.
    """

    def __init__(self, c_in: int, c_out: int):
        super().__init__()
        self.norm = group_norm(c_in)
        self.conv = zeroed(nn.Conv2d(c_in, c_out, 3, padding=1))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        with full_precision(x):
            y: torch.Tensor = self.conv(functional.silu(self.norm(x.float())))
        return y


class DirectNet(nn.Module):
    """Heights from one image, without a simulator.

    Input channels per height sample: log((I + eps) / (1 + eps)) and the raw
    image clipped, I relative to the light of a flat plate, (m/n)^2 pixels of
    n_w wavelengths each. A fresh network answers with a flat plate.

    Args:
        config: architecture.
        scene: number of wavelengths, m/n, light of a flat plate.

    Raises:
        InputError: m is no multiple of n.
    """

    flat: torch.Tensor

    def __init__(self, config: DirectConfig, scene: Scene):
        super().__init__()
        self.config, self.scene = config, scene
        self.ratio = resolution_ratio(scene.image_pixels, scene.height_samples)
        width = config.backbone.widths[0]
        self.register_buffer("flat", flat_irradiance(scene), persistent=False)
        self.stem = nn.Conv2d(2 * scene.n_wavelengths * self.ratio**2, width, 3, padding=1)
        self.backbone = Backbone(config.backbone)
        self.head = Head(width, 1)

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        """Estimate heights.

        Args:
            image: irradiance, shape [B, n_w, m, m] [W/m^2].

        Returns:
            Relief, shape [B, n, n] [m].
        """
        check_image(image, self.scene, "image")
        encoding = self.config.encoding
        with full_precision(image):
            relative = image.float() / self.flat
            encoded = (
                log_image(relative, encoding.log_floor),
                clipped_image(relative, encoding.irradiance_clip),
            )
            x = functional.pixel_unshuffle(torch.cat(encoded, dim=1), self.ratio)
        heights: torch.Tensor = self.head(self.backbone(self.stem(x)))[:, 0] * encoding.height_unit_m
        return heights


class UnrolledUpdater(nn.Module):
    """A learned step: current heights, what they would look like, what was seen -> better heights.

    Besides the encoded target image of :class:`DirectNet` the network sees the
    simulated image (log), the residual (difference of logs, difference of
    clipped images), the current heights and their slopes, the gradient as
    asinh(g / RMS), and its own memory of the steps before. The update is added
    in float32. A fresh network changes nothing.

    Stem and backbone have the shapes of a DirectNet of the same backbone, see
    :func:`warm_start`.

    Args:
        config: architecture.
        scene: number of wavelengths, m/n, light of a flat plate, sample pitch.

    Raises:
        InputError: m is no multiple of n.
    """

    flat: torch.Tensor

    def __init__(self, config: UnrolledConfig, scene: Scene):
        super().__init__()
        self.config, self.scene = config, scene
        self.ratio = resolution_ratio(scene.image_pixels, scene.height_samples)
        width, pixels = config.backbone.widths[0], scene.n_wavelengths * self.ratio**2
        self.register_buffer("flat", flat_irradiance(scene), persistent=False)
        self.stem = nn.Conv2d(2 * pixels, width, 3, padding=1)
        c_state = 3 * pixels + 3 + config.use_gradient + config.hidden_channels
        # Without bias: the stem has one.
        self.state_stem = nn.Conv2d(c_state, width, 3, padding=1, bias=False)
        self.step_embedding = nn.Embedding(config.numbered_steps, width) if config.numbered_steps else None
        if self.step_embedding is not None:
            nn.init.zeros_(self.step_embedding.weight)
        self.backbone = Backbone(config.backbone)
        self.head = Head(width, 1)
        self.hidden_head = nn.Conv2d(width, config.hidden_channels, 3, padding=1) if config.hidden_channels else None

    def forward(
        self,
        target: torch.Tensor,
        simulated: torch.Tensor,
        heights: torch.Tensor,
        gradient: torch.Tensor | None = None,
        hidden: torch.Tensor | None = None,
        step: int = 0,
    ) -> Update:
        """Improve heights once.

        Args:
            target: irradiance that was seen, shape [B, n_w, m, m] [W/m^2].
            simulated: irradiance behind ``heights``, shape [B, n_w, m, m] [W/m^2].
            heights: current relief, shape [B, n, n] [m].
            gradient: of any image loss with respect to ``heights``, shape [B, n, n]; its scale does not matter.
                Unused, and may be None, with ``use_gradient=False``.
            hidden: memory that the last step returned, shape [B, c, n, n]; None before the first.
            step: number of the iteration, from 0; unused without ``numbered_steps``.

        Returns:
            Improved heights and memory.
        """
        check_image(target, self.scene, "target image")
        check_image(simulated, self.scene, "simulated image")
        check_heights(heights, self.scene, "heights")
        with full_precision(target):
            seen, state = self._encoded(target.float(), simulated.float(), heights.float(), gradient, hidden)
        x = self.stem(seen) + self.state_stem(state)
        if self.step_embedding is not None:
            number = min(step, self.config.numbered_steps - 1)
            x = x + self.step_embedding.weight[number].reshape(1, -1, 1, 1)
        y = self.backbone(x)
        updated = heights.float() + self.head(y)[:, 0] * self.config.encoding.height_unit_m
        return Update(updated, torch.tanh(self.hidden_head(y)) if self.hidden_head is not None else None)

    def _encoded(
        self,
        target: torch.Tensor,
        simulated: torch.Tensor,
        heights: torch.Tensor,
        gradient: torch.Tensor | None,
        hidden: torch.Tensor | None,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Channels for the two stems, shapes [B, 2 n_w (m/n)^2, n, n] and [B, c, n, n]."""
        encoding, (batch, n, _) = self.config.encoding, heights.shape
        target, simulated = target / self.flat, simulated / self.flat
        logs = [log_image(image, encoding.log_floor) for image in (target, simulated)]
        raws = [clipped_image(image, encoding.irradiance_clip) for image in (target, simulated)]
        # Differences are taken here: lower precision would lose them in the values.
        images = torch.cat((logs[1], logs[0] - logs[1], raws[0] - raws[1]), dim=1)
        relief = heights[:, None]
        state = [
            functional.pixel_unshuffle(images, self.ratio),
            relief / encoding.height_unit_m,
            slopes(relief, self.scene.sample_pitch_m, encoding.slope_clip),
        ]
        if self.config.use_gradient:
            if gradient is None:
                raise MismatchError("this network takes the gradient of the simulation, but none was given; pass it")
            check_heights(gradient, self.scene, "gradient")
            state.append(scaled_gradient(gradient.float()[:, None]))
        if self.config.hidden_channels:
            if hidden is None:
                hidden = heights.new_zeros(batch, self.config.hidden_channels, n, n)
            state.append(hidden.float())
        return functional.pixel_unshuffle(torch.cat((logs[0], raws[0]), dim=1), self.ratio), torch.cat(state, dim=1)


@torch.no_grad()
def warm_start(updater: UnrolledUpdater, direct: DirectNet, *, keep_head: bool) -> None:
    """Give an updater the weights of a trained direct network.

    Inputs that only the updater has start with weight 0.

    Args:
        updater: changed in place.
        direct: of the same backbone and encoding, for the same scene.
        keep_head: True: the first step from flat heights is the answer of ``direct``. False: the updater
            changes nothing at first, to start from that answer and learn the rest.

    Raises:
        MismatchError: backbone, encoding or scene differ.
    """
    for name, ours, theirs in (
        ("backbones", updater.config.backbone, direct.config.backbone),
        ("encodings", updater.config.encoding, direct.config.encoding),
        ("scenes", updater.scene, direct.scene),
    ):
        if ours != theirs:
            raise MismatchError(f"the {name} of updater and direct network differ ({ours} and {theirs}); use one")
    updater.stem.load_state_dict(direct.stem.state_dict())
    updater.backbone.load_state_dict(direct.backbone.state_dict())
    updater.head.load_state_dict(direct.head.state_dict())
    nn.init.zeros_(updater.state_stem.weight)
    if updater.step_embedding is not None:
        nn.init.zeros_(updater.step_embedding.weight)
    if not keep_head:
        zeroed(updater.head.conv)


def check_image(image: torch.Tensor, scene: Scene, name: str) -> None:
    """Refuse an image that is not of the scene; one channel must never broadcast into three.

    Args:
        image: should have shape [B, n_w, m, m].
        scene: what the network was built for.
        name: of the image, for the message.

    Raises:
        MismatchError: another shape.
    """
    _check_shape(image, (scene.n_wavelengths, scene.image_pixels, scene.image_pixels), name)


def check_heights(heights: torch.Tensor, scene: Scene, name: str) -> None:
    """Refuse a height map that is not of the scene.

    Args:
        heights: should have shape [B, n, n].
        scene: what the network was built for.
        name: of the map, for the message.

    Raises:
        MismatchError: another shape.
    """
    _check_shape(heights, (scene.height_samples, scene.height_samples), name)


def _check_shape(x: torch.Tensor, expected: tuple[int, ...], name: str) -> None:
    if x.ndim != len(expected) + 1 or tuple(x.shape[1:]) != expected:
        wanted = ", ".join(("B", *map(str, expected)))
        raise MismatchError(
            f"{name} has shape {list(x.shape)}, the network was built for [{wanted}]; "
            "use a network for this scene, or resample"
        )
