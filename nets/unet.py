"""The U-Net that denoiser and updater of the paper's family share (Fig. 1, Tab. 2).

What the supplement leaves open, and what is done here:

- Both kernel ranges begin at 2, the stride of a halving: k_down is the kernel
  of the strided convolution down to the next level, k_up that of the
  transposed convolution back up. Each doubles or halves exactly, whatever k.
- Level l has c_0 * m_s^l channels, n_s levels below the first.
- After the skip is concatenated, a 3 x 3 convolution merges: its kernel is in
  no table, and it is the smallest that sees neighbours.
- A nonlinearity follows every convolution; no normalisation layers.
- Convolutions pad with zeros, sizes that do not halve n_s times with their edge.
"""

import torch
from torch import nn
from torch.nn import functional

from nets.config import NetworkConfig, Nonlinearity
from nets.padding import crop_padding, pad_to_multiple
from nets.wide_convolutions import convolved, doubled, halved, is_wanted, widened

MERGE_KERNEL = 3

_NONLINEARITIES: dict[str, type[nn.Module]] = {"ELU": nn.ELU, "ReLU": nn.ReLU, "PReLU": nn.PReLU, "SELU": nn.SELU}


def nonlinear(name: Nonlinearity) -> nn.Module:
    """The nonlinearity of that name; a PReLU learns one slope."""
    return _NONLINEARITIES[name]()


def kernel_margins(kernel: int, stride: int) -> tuple[int, int]:
    """Zeros (before, after) with which a strided convolution turns H into H / stride exactly.

    Where their number is odd the extra one goes after.

    Args:
        kernel: kernel size, at least ``stride``.
        stride: divides H.
    """
    return (kernel - stride) // 2, (kernel - stride + 1) // 2


class ConvBlock(nn.Module):
    """Convolution and nonlinearity; shape [B, c_in, H, W] -> [B, c_out, H / stride, W / stride], any kernel >= stride.

    Even kernels of stride 1 reach one sample further after than before.
    """

    def __init__(self, c_in: int, c_out: int, kernel: int, nonlinearity: Nonlinearity, stride: int = 1):
        super().__init__()
        self.margins = kernel_margins(kernel, stride)
        self.is_centred = stride == 1 and kernel % 2 == 1
        self.conv = nn.Conv2d(c_in, c_out, kernel, stride=stride)
        self.nonlinearity = nonlinear(nonlinearity)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        conv = self.conv
        if self.is_centred and is_wanted(x, conv.weight):
            y: torch.Tensor = self.nonlinearity(convolved(widened(x), conv.weight, conv.bias))
        else:
            y = self.nonlinearity(conv(functional.pad(x, self.margins * 2)))
        return y


class DownBlock(nn.Module):
    """Halve and multiply channels; shape [B, c_in, H, W] -> [B, c_out, H/2, W/2] for even H, W.

    An odd kernel is centred on the first of the two samples that become one, as
    :class:`UpBlock` puts it back: down and up shift nothing.
    """

    def __init__(self, c_in: int, c_out: int, kernel: int, nonlinearity: Nonlinearity):
        super().__init__()
        self.conv = nn.Conv2d(c_in, c_out, kernel, stride=2, padding=(kernel - 1) // 2)
        self.nonlinearity = nonlinear(nonlinearity)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        conv = self.conv
        is_wide = is_wanted(x, conv.weight)
        y: torch.Tensor = self.nonlinearity(halved(x, conv.weight, conv.bias) if is_wide else conv(x))
        return y


class UpBlock(nn.Module):
    """Double; shape [B, c_in, H, W] -> [B, c_out, 2H, 2W]."""

    def __init__(self, c_in: int, c_out: int, kernel: int, nonlinearity: Nonlinearity):
        super().__init__()
        self.conv = nn.ConvTranspose2d(
            c_in, c_out, kernel, stride=2, padding=(kernel - 1) // 2, output_padding=kernel % 2
        )
        self.nonlinearity = nonlinear(nonlinearity)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        conv = self.conv
        is_wide = is_wanted(x, conv.weight)
        y: torch.Tensor = self.nonlinearity(doubled(x, conv.weight, conv.bias) if is_wide else conv(x))
        return y


class UNet(nn.Module):
    """U-Net of any depth; shape [B, c_in, H, W] -> [B, c_out, H, W], any H, W.

    Args:
        network: k_down, k_up, m_s, n_s and the nonlinearity.
        c_in: channels of the input, c_0 of the levels.
        c_out: channels of the output.
    """

    def __init__(self, network: NetworkConfig, c_in: int, c_out: int):
        super().__init__()
        channels = [c_in * network.m_s**level for level in range(network.n_s + 1)]
        # What the merge of each level returns, the lowest level returns its own channels.
        merged = [c_out, *channels[1:]]
        levels, nonlinearity = range(network.n_s), network.nonlinearity
        self.multiple = 2**network.n_s
        self.down = nn.ModuleList(
            DownBlock(channels[level], channels[level + 1], network.k_down, nonlinearity) for level in levels
        )
        self.up = nn.ModuleList(
            UpBlock(merged[level + 1], merged[level], network.k_up, nonlinearity) for level in levels
        )
        self.merge = nn.ModuleList(
            ConvBlock(merged[level] + channels[level], merged[level], MERGE_KERNEL, nonlinearity) for level in levels
        )

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        size = (x.shape[-2], x.shape[-1])
        x = pad_to_multiple(x, self.multiple)
        skips = []
        for down in self.down:
            skips.append(x)
            x = down(x)
        for up, merge, skip in zip(reversed(self.up), reversed(self.merge), reversed(skips), strict=True):
            x = merge(torch.cat((up(x), skip), dim=1))
        return crop_padding(x, size, self.multiple)
