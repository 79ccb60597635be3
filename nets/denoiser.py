"""The paper's denoiser: a noisy simulated image -> the image of many more light paths."""

import torch
from torch import nn

from nets.config import DenoiserConfig
from nets.encoding import full_precision
from nets.unet import ConvBlock, UNet
from warp_caustics.errors import MismatchError

EDGE_KERNEL = 3
"""Kernel of the blocks before and after the U-Net; the tables name none."""


class Denoiser(nn.Module):
    """One channel in and out, each wavelength on its own, so any number of them and any image size fit.

    A block of convolution and nonlinearity expands to c_init channels, the
    U-Net follows, a convolution contracts to one. The contraction has no
    nonlinearity, unlike the supplement's "equivalent block": a ReLU there can
    die and would forbid negative corrections. The image is divided by
    ``irradiance_unit_W_m2`` on the way in and multiplied on the way out.

    Args:
        config: architecture.
    """

    def __init__(self, config: DenoiserConfig):
        super().__init__()
        network, c_init = config.network, config.network.c_init or 1
        self.config = config
        self.expand = ConvBlock(1, c_init, EDGE_KERNEL, network.nonlinearity)
        self.unet = UNet(network, c_init, c_init)
        self.contract = nn.Conv2d(c_init, 1, EDGE_KERNEL, padding=EDGE_KERNEL // 2)

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        """Denoise.

        Args:
            image: irradiance, shape [B, n_w, H, W] [W/m^2].

        Returns:
            Shape [B, n_w, H, W], float32 [W/m^2].

        Raises:
            MismatchError: another number of dimensions.
        """
        if image.ndim != 4:
            raise MismatchError(f"image has shape {list(image.shape)}; give [B, n_w, H, W]")
        batch, channels, rows, columns = image.shape
        unit = self.config.irradiance_unit_W_m2
        x = image.float().reshape(batch * channels, 1, rows, columns) / unit
        y = self.unet(self.expand(x))
        # Output and sum in float32: bfloat16 would add noise of its own.
        with full_precision(y):
            answer = self.contract(y.float())
        if self.config.is_residual:
            answer = x + answer
        denoised: torch.Tensor = (answer * unit).reshape(batch, channels, rows, columns)
        return denoised
