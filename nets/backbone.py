"""The residual U-Net that this project's own networks share.

Fits ``torch.compile``, autocast and channels_last: no data-dependent branch, no
normalisation with state.
"""

import math
from itertools import pairwise

import torch
from torch import nn
from torch.nn import functional

from nets.encoding import full_precision
from nets.padding import crop_padding, pad_to_multiple
from nets.residual_config import BackboneConfig

MAX_GROUPS = 32
CODE = 128
"""Numbers that what a network is told becomes, shared by all its blocks."""


def group_norm(channels: int) -> nn.GroupNorm:
    """Group normalisation with as many groups as divide ``channels``, at most 32."""
    return nn.GroupNorm(math.gcd(channels, MAX_GROUPS), channels)


def zeroed(conv: nn.Conv2d) -> nn.Conv2d:
    """The convolution with weights and bias 0: a branch that starts as nothing."""
    nn.init.zeros_(conv.weight)
    if conv.bias is not None:
        nn.init.zeros_(conv.bias)
    return conv


class Code(nn.Module):
    """What a network is told as numbers that all its blocks share; shape [B, 2 P] -> [B, CODE], always in float32."""

    def __init__(self, conditions: int):
        super().__init__()
        self.layers = nn.Sequential(nn.Linear(2 * conditions, CODE), nn.SiLU(), nn.Linear(CODE, CODE), nn.SiLU())

    def forward(self, told: torch.Tensor) -> torch.Tensor:
        with full_precision(told):
            code: torch.Tensor = self.layers(told.float())
        return code


class Film(nn.Module):
    """Each channel scaled and shifted by what is told (FiLM: Perez et al. 2018); starts as nothing.

    Shape [B, c, H, W] and a code [B, CODE] -> [B, c, H, W].
    """

    def __init__(self, channels: int):
        super().__init__()
        self.linear = nn.Linear(CODE, 2 * channels)
        nn.init.zeros_(self.linear.weight)
        nn.init.zeros_(self.linear.bias)

    def forward(self, y: torch.Tensor, code: torch.Tensor) -> torch.Tensor:
        with full_precision(y):
            scale, shift = self.linear(code).to(y.dtype)[:, :, None, None].chunk(2, dim=1)
        changed: torch.Tensor = y * (1 + scale) + shift
        return changed


class ResidualBlock(nn.Module):
    """Normalise, SiLU, 3 x 3 convolution, twice, added to the input; shape [B, c_in, H, W] -> [B, c_out, H, W].

    The last convolution starts at zero, so a fresh block passes its input on
    (through a 1 x 1 convolution where the number of channels changes). A block
    that is told something scales and shifts its channels by it between both.
    """

    def __init__(self, c_in: int, c_out: int, *, is_told: bool = False):
        super().__init__()
        self.norm_1 = group_norm(c_in)
        self.conv_1 = nn.Conv2d(c_in, c_out, 3, padding=1)
        self.norm_2 = group_norm(c_out)
        self.conv_2 = zeroed(nn.Conv2d(c_out, c_out, 3, padding=1))
        self.skip = nn.Conv2d(c_in, c_out, 1) if c_in != c_out else nn.Identity()
        self.film = Film(c_out) if is_told else None

    def forward(self, x: torch.Tensor, code: torch.Tensor | None = None) -> torch.Tensor:
        y = self.norm_2(self.conv_1(functional.silu(self.norm_1(x))))
        if self.film is not None and code is not None:
            y = self.film(y, code)
        y = self.conv_2(functional.silu(y))
        total: torch.Tensor = self.skip(x) + y
        return total


class SelfAttention(nn.Module):
    """Every position looks at every other; shape [B, c, H, W] -> the same, added to the input, starting at zero."""

    def __init__(self, channels: int, head_channels: int):
        super().__init__()
        self.n_heads = next(n for n in range(-(-channels // head_channels), channels + 1) if channels % n == 0)
        self.norm = group_norm(channels)
        self.qkv = nn.Conv2d(channels, 3 * channels, 1)
        self.out = zeroed(nn.Conv2d(channels, channels, 1))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        batch, channels, rows, columns = x.shape
        qkv = self.qkv(self.norm(x)).flatten(2).transpose(1, 2)  # [B, HW, 3c]
        heads = qkv.reshape(batch, rows * columns, 3, self.n_heads, channels // self.n_heads)
        q, k, v = heads.permute(2, 0, 3, 1, 4).unbind(0)  # each [B, heads, HW, c / heads]
        y = functional.scaled_dot_product_attention(q, k, v)
        y = y.transpose(1, 2).reshape(batch, rows, columns, channels).permute(0, 3, 1, 2)
        added: torch.Tensor = x + self.out(y)
        return added


class Level(nn.Module):
    """Residual blocks, then attention where wanted; shape [B, c_in, H, W] -> [B, c_out, H, W]."""

    def __init__(self, c_in: int, c_out: int, depth: int, head_channels: int | None, *, is_told: bool = False):
        super().__init__()
        blocks: list[nn.Module] = [
            ResidualBlock(c_in if i == 0 else c_out, c_out, is_told=is_told) for i in range(depth)
        ]
        if head_channels is not None:
            blocks.append(SelfAttention(c_out, head_channels))
        self.blocks = nn.Sequential(*blocks)

    def forward(self, x: torch.Tensor, code: torch.Tensor | None = None) -> torch.Tensor:
        for block in self.blocks:
            x = block(x, code) if isinstance(block, ResidualBlock) else block(x)
        return x


class Backbone(nn.Module):
    """Residual U-Net; shape [B, widths[0], n, n] -> the same, any n.

    Down by a convolution of stride 2, up by repeated samples and a convolution
    (no checkerboard), skips concatenated. Sizes that do not halve often enough
    are padded with their edge and cropped again. With ``conditions`` it is told
    something besides, shape [B, 2 P]; None tells it that nothing is known.
    """

    def __init__(self, config: BackboneConfig):
        super().__init__()
        widths, n_levels = config.widths, len(config.widths)
        heads = [config.head_channels if level in config.attention_levels else None for level in range(n_levels)]
        self.multiple = 2 ** (n_levels - 1)
        self.conditions, is_told = config.conditions, config.conditions > 0
        self.down = nn.ModuleList(
            Level(w, w, d, h, is_told=is_told) for w, d, h in zip(widths, config.depths, heads, strict=True)
        )
        self.shrink = nn.ModuleList(
            nn.Conv2d(fine, coarse, 3, stride=2, padding=1) for fine, coarse in pairwise(widths)
        )
        self.grow = nn.ModuleList(nn.Conv2d(coarse, fine, 3, padding=1) for fine, coarse in pairwise(widths))
        self.up = nn.ModuleList(
            Level(2 * w, w, d, h, is_told=is_told)
            for w, d, h in zip(widths[:-1], config.depths[:-1], heads[:-1], strict=True)
        )
        # Last, so that the weights of all others are drawn as without it.
        self.code = Code(config.conditions) if is_told else None

    def forward(self, x: torch.Tensor, told: torch.Tensor | None = None) -> torch.Tensor:
        size = (x.shape[-2], x.shape[-1])
        code = None
        if self.code is not None:
            code = self.code(x.new_zeros(len(x), 2 * self.conditions) if told is None else told)
        x = pad_to_multiple(x, self.multiple)
        skips = []
        for level, shrink in zip(self.down[:-1], self.shrink, strict=True):
            skips.append(level(x, code))
            x = shrink(skips[-1])
        x = self.down[-1](x, code)
        for level, grow, skip in zip(reversed(self.up), reversed(self.grow), reversed(skips), strict=True):
            x = grow(functional.interpolate(x, scale_factor=2.0, mode="nearest"))
            x = level(torch.cat((x, skip), dim=1), code)
        return crop_padding(x, size, self.multiple)


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
