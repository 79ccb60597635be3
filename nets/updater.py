"""The paper's updater: one learned step of gradient descent on the heights."""

import math

import torch
from torch import nn

from nets.backbone import zeroed
from nets.config import NetworkConfig, UpdaterConfig
from nets.encoding import full_precision
from nets.input_shapes import check_heights, check_image
from nets.padding import resolution_ratio
from nets.unet import ConvBlock, UNet
from warp_caustics.errors import MismatchError
from warp_caustics.scene import Scene

LAST_KERNEL = 3
"""Kernel of the convolution that makes the update; the tables name none."""


def output_strides(ratio: int, k_dec: int) -> tuple[int, ...]:
    """Strides of the output blocks that bring an image to the resolution of the heights.

    A block of kernel k_dec shrinks by what its kernel and the remaining ratio
    have in common; where that is nothing, one block takes the whole rest. At
    least one block, because channels are divided there. Tab. 1 (ratio 4): two
    blocks of stride 2 for k_dec = 2, one of stride 4 for 4, 8 and 16.

    Args:
        ratio: m / n, at least 1.
        k_dec: kernel of each block.

    Returns:
        Strides whose product is ``ratio``.
    """
    strides: list[int] = []
    while ratio > 1 or not strides:
        shared = math.gcd(ratio, k_dec)
        strides.append(shared if shared > 1 else ratio)
        ratio //= strides[-1]
    return tuple(strides)


class Branch(nn.Module):
    """U-Net and output blocks; shape [B, c_in, r n, r n] -> [B, channels, n, n].

    No block precedes the U-Net (Tab. 2 gives the updater no c_init), so its
    level l has c_in * m_s^l channels. Its output keeps m_s * c_in channels: that
    is what each output block divides by m_dec, rounded down, at least 1.

    Args:
        network: numbers of Tab. 2.
        c_in: channels of the input.
        ratio: r, resolution of the input over that of the heights.
    """

    def __init__(self, network: NetworkConfig, c_in: int, ratio: int):
        super().__init__()
        m_dec, k_dec = network.m_dec or 1, network.k_dec or 1
        self.channels = c_in * network.m_s
        self.unet = UNet(network, c_in, self.channels)
        blocks = []
        for stride in output_strides(ratio, k_dec):
            c_out = max(1, self.channels // m_dec)
            blocks.append(ConvBlock(self.channels, c_out, max(k_dec, stride), network.nonlinearity, stride))
            self.channels = c_out
        self.output = nn.Sequential(*blocks)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        y: torch.Tensor = self.output(self.unet(x))
        return y


class Updater(nn.Module):
    """Current heights, what they would look like, what was seen, and the gradient -> better heights.

    The image branch sees target and simulated image (2 n_w channels) at image
    resolution, the height branch heights and gradient (2 channels) at theirs.
    Both end in output blocks, are concatenated, and a 3 x 3 convolution makes
    the update, which is added to the heights in float32. That convolution
    starts at zero: a fresh updater changes nothing.

    The network works with irradiance, heights and gradient divided by
    ``irradiance_unit_W_m2``, ``height_unit_m`` and ``gradient_unit``; the update
    is multiplied by ``height_unit_m``.

    Args:
        config: architecture.
        scene: n_w, n and m; m must be a multiple of n.

    Raises:
        InputError: m is no multiple of n.
    """

    def __init__(self, config: UpdaterConfig, scene: Scene):
        super().__init__()
        self.config, self.scene = config, scene
        ratio = resolution_ratio(scene.image_pixels, scene.height_samples)
        self.image_branch = Branch(config.network, 2 * scene.n_wavelengths, ratio)
        self.height_branch = Branch(config.network, 1 + config.use_gradient, 1)
        both = self.image_branch.channels + self.height_branch.channels
        self.update = zeroed(nn.Conv2d(both, 1, LAST_KERNEL, padding=LAST_KERNEL // 2))

    def forward(
        self,
        target: torch.Tensor,
        simulated: torch.Tensor,
        heights: torch.Tensor,
        gradient: torch.Tensor | None = None,
    ) -> torch.Tensor:
        """Improve heights once.

        Args:
            target: irradiance that was seen, shape [B, n_w, m, m] [W/m^2].
            simulated: irradiance behind ``heights``, denoised, shape [B, n_w, m, m] [W/m^2].
            heights: current relief, shape [B, n, n] [m].
            gradient: of 1/2 sum_w mean_pixels (simulated - target)^2 with respect to ``heights``,
                shape [B, n, n] [W^2/m^5]. Unused, and may be None, with ``use_gradient=False``.

        Returns:
            Improved relief, shape [B, n, n], float32 [m].

        Raises:
            MismatchError: a shape that is not the scene's, or a missing gradient.
        """
        check_image(target, self.scene, "target image")
        check_image(simulated, self.scene, "simulated image")
        check_heights(heights, self.scene, "heights")
        config = self.config
        images = torch.cat((target.float(), simulated.float()), dim=1) / config.irradiance_unit_W_m2
        maps = [heights.float() / config.height_unit_m]
        if config.use_gradient:
            if gradient is None:
                raise MismatchError("this updater takes the gradient of the simulation, but none was given; pass it")
            check_heights(gradient, self.scene, "gradient")
            maps.append(gradient.float() / config.gradient_unit)
        both = torch.cat((self.image_branch(images), self.height_branch(torch.stack(maps, dim=1))), dim=1)
        with full_precision(both):
            update: torch.Tensor = self.update(both.float())[:, 0] * config.height_unit_m
        return heights.float() + update
