"""``direct``: this project's own network from an image to heights at once.

Images come to the resolution of the height map by moving the m/n x m/n pixels
above a height sample into channels, so nothing is lost. Inputs and outputs are
physical quantities in SI units and float32; under autocast only the
:class:`nets.backbone.Backbone` runs in lower precision.
"""

import torch
from torch import nn
from torch.nn import functional

from nets.backbone import Backbone, Head, zeroed
from nets.encoding import clipped_image, flat_irradiance, full_precision, log_image
from nets.input_shapes import check_image
from nets.padding import resolution_ratio
from nets.residual_config import DirectConfig
from nets.told import told_count
from nets.told_maps import ToldMaps
from warp_caustics.errors import InputError
from warp_caustics.scene import Scene


class DirectNet(nn.Module):
    """Heights from one image, without a simulator.

    Input channels per height sample: log((I + eps) / (1 + eps)) and the raw
    image clipped, I relative to the light of a flat plate, (m/n)^2 pixels of
    n_w wavelengths each. A fresh network answers with a flat plate. With ``backbone.conditions`` it is told of its
    bench besides (:mod:`nets.told`), by the way of ``told_by``, and sees pictures that :mod:`nets.flat_light` has moved
    and levelled.

    With ``feedback`` it is also given an answer and the image that this would make, its *echo*, encoded as the image
    is: what differs between both is where the answer is wrong. A flat plate and its even light are all zeros, so that a
    first look is one at a flat answer. It mixes the given answer into its own, sample by sample.

    Args:
        config: architecture.
        scene: number of wavelengths, m/n, light of a flat plate.

    Raises:
        InputError: m is no multiple of n, or ``conditions`` are not as many as there are.
    """

    flat: torch.Tensor

    def __init__(self, config: DirectConfig, scene: Scene):
        super().__init__()
        self.config, self.scene = config, scene
        count = told_count(scene.n_wavelengths)
        if config.backbone.conditions not in (0, count):
            raise InputError(
                f"network.backbone.conditions is {config.backbone.conditions}, for {scene.n_wavelengths} wavelengths "
                f"there are {count} numbers to tell; set it to {count}, or 0 to tell nothing"
            )
        self.ratio = resolution_ratio(scene.image_pixels, scene.height_samples)
        width = config.backbone.widths[0]
        self.register_buffer("flat", flat_irradiance(scene), persistent=False)
        self.stem = nn.Conv2d(2 * scene.n_wavelengths * self.ratio**2, width, 3, padding=1)
        # Blocks have weights for what is told where they scale and shift by it, and nowhere else.
        own = config.backbone if config.told_by == "film" else config.backbone.model_copy(update={"conditions": 0})
        self.backbone, has = Backbone(own), config.feedback
        self.head = Head(width, 1)
        # Last, so that the weights of all others are drawn as without it.
        self.look = zeroed(nn.Conv2d(self.stem.in_channels + 1, width, 3, padding=1, bias=False)) if has else None
        self.keep = Head(width, 1) if has else None
        self.maps = ToldMaps(scene, width) if config.told_by == "maps" else None

    @property
    def is_told(self) -> bool:
        """Whether it is told of its bench."""
        return self.config.backbone.conditions > 0

    @property
    def has_feedback(self) -> bool:
        """Whether it takes an answer and its echo."""
        return self.look is not None

    def forward(
        self,
        image: torch.Tensor,
        told: torch.Tensor | None = None,
        answer: torch.Tensor | None = None,
        echo: torch.Tensor | None = None,
    ) -> torch.Tensor:
        """Estimate heights.

        Args:
            image: irradiance, shape [B, n_w, m, m] [W/m^2].
            told: of the bench, shape [B, 2 P], see :func:`nets.told.dropped`; None: nothing is known.
            answer: an earlier relief, shape [B, n, n] [m]; None: a flat plate. Only with ``feedback``.
            echo: the image that it would make, shape of ``image``; given together.

        Returns:
            Relief, shape [B, n, n] [m].
        """
        check_image(image, self.scene, "image")
        x, unit = self.stem(self._encoded(image)), self.config.encoding.height_unit_m
        if answer is not None and echo is not None and self.look is not None:
            x = x + self.look(torch.cat((self._encoded(echo), answer.float()[:, None] / unit), dim=1))
        if self.maps is not None and told is not None:
            x = x + self.maps(told).to(x.dtype)
        x = self.backbone(x, told)
        heights: torch.Tensor = self.head(x)[:, 0] * unit
        if self.keep is not None:
            given = torch.zeros_like(heights) if answer is None else answer.float()
            heights = heights + self.keep(x)[:, 0] * (given - heights)
        return heights

    def _encoded(self, image: torch.Tensor) -> torch.Tensor:
        """An image at the resolution of the height map, shape [B, 2 n_w (m/n)^2, n, n]."""
        encoding = self.config.encoding
        with full_precision(image):
            relative = image.float() / self.flat
            encoded = (
                log_image(relative, encoding.log_floor),
                clipped_image(relative, encoding.irradiance_clip),
            )
            return functional.pixel_unshuffle(torch.cat(encoded, dim=1), self.ratio)
