"""``unrolled``: this project's own learned step of an iterative scheme, with a memory.

Images come to the resolution of the height map by moving the m/n x m/n pixels
above a height sample into channels, so nothing is lost. Inputs and outputs are
physical quantities in SI units and float32; under autocast only the
:class:`nets.backbone.Backbone` runs in lower precision.
"""

from typing import NamedTuple

import torch
from torch import nn
from torch.nn import functional

from nets.backbone import Backbone, Head, zeroed
from nets.direct_net import DirectNet
from nets.encoding import clipped_image, flat_irradiance, full_precision, log_image, scaled_gradient, slopes
from nets.input_shapes import check_heights, check_image
from nets.padding import resolution_ratio
from nets.residual_config import UnrolledConfig
from warp_caustics.errors import MismatchError
from warp_caustics.scene import Scene


class Update(NamedTuple):
    """One step of an iterative scheme."""

    heights: torch.Tensor
    """Improved heights, shape [B, n, n] [m]."""
    hidden: torch.Tensor | None
    """Memory for the next step, shape [B, c, n, n]; None for a network without."""


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
