"""Receptive fields: how much of an input one output value can depend on through convolutions.

Found by walking backwards from one output sample, as an interval of indices:
each layer widens it. Padding only shifts it, so sizes do not matter; where
resolutions change, the widest of all positions counts. What normalisation and
attention see, the whole plate, is named apart.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from nets.architecture import Architecture
from nets.config import DenoiserConfig, NetworkConfig, UpdaterConfig
from nets.denoiser import EDGE_KERNEL
from nets.padding import resolution_ratio
from nets.residual_config import BackboneConfig
from nets.unet import MERGE_KERNEL, kernel_margins
from nets.updater import LAST_KERNEL, output_strides
from warp_caustics.scene import Scene

Span = tuple[int, int]
"""First and last index, both included."""


@dataclass(frozen=True)
class ReceptiveField:
    """Side of the square that one output value depends on.

    Attributes:
        image_pixels: in the image, None if there is none.
        height_samples: in the current heights and their gradient, None if there are none.
        sees_all: normalisation or attention add a dependence on everything else.
    """

    image_pixels: int | None
    height_samples: int | None
    sees_all: bool


def receptive_field(architecture: Architecture, scene: Scene) -> ReceptiveField:
    """Receptive field of a network.

    Args:
        architecture: of the network.
        scene: gives the ratio of image and height resolution.
    """
    if isinstance(architecture, DenoiserConfig):
        period = range(2**architecture.network.n_s)
        return ReceptiveField(max(_size(_denoiser(architecture.network, (i, i))) for i in period), None, False)
    ratio = resolution_ratio(scene.image_pixels, scene.height_samples)
    if isinstance(architecture, UpdaterConfig):
        period = range(2**architecture.network.n_s)
        image = max(_size(_branch(architecture.network, (i, i), ratio)) for i in period)
        return ReceptiveField(image, max(_size(_branch(architecture.network, (i, i), 1)) for i in period), False)
    period = range(2 ** (len(architecture.backbone.widths) - 1))
    samples = max(_size(_residual(architecture.backbone, (i, i))) for i in period)
    # Slopes of the current heights reach one sample further.
    heights = samples + 2 if architecture.kind == "unrolled" else None
    return ReceptiveField(samples * ratio, heights, True)


def _size(span: Span) -> int:
    return span[1] - span[0] + 1


def _union(a: Span, b: Span) -> Span:
    return min(a[0], b[0]), max(a[1], b[1])


def _conv(span: Span, kernel: int, stride: int = 1, before: int | None = None) -> Span:
    """What a convolution reads to write ``span``; ``before`` samples are padded in front."""
    first = kernel_margins(kernel, stride)[0] if before is None else before
    return span[0] * stride - first, span[1] * stride - first + kernel - 1


def _transposed(span: Span, kernel: int) -> Span:
    """What a transposed convolution of stride 2 reads to write ``span``; (k - 1) // 2 samples are cropped in front."""
    low, high = span[0] + (kernel - 1) // 2, span[1] + (kernel - 1) // 2
    return -((kernel - 1 - low) // 2), high // 2


def _unet(network: NetworkConfig, span: Span, level: int = 0) -> Span:
    if level == network.n_s:
        return span
    merged = _conv(span, MERGE_KERNEL)
    below = _unet(network, _transposed(merged, network.k_up), level + 1)
    return _union(merged, _conv(below, network.k_down, stride=2, before=(network.k_down - 1) // 2))


def _denoiser(network: NetworkConfig, span: Span) -> Span:
    return _conv(_unet(network, _conv(span, EDGE_KERNEL)), EDGE_KERNEL)


def _branch(network: NetworkConfig, span: Span, ratio: int) -> Span:
    span = _conv(span, LAST_KERNEL)
    k_dec = network.k_dec or 1
    for stride in reversed(output_strides(ratio, k_dec)):
        span = _conv(span, max(k_dec, stride), stride)
    return _unet(network, span)


def _blocks(span: Span, depth: int) -> Span:
    # Two 3 x 3 convolutions each.
    return span[0] - 2 * depth, span[1] + 2 * depth


def _backbone(depths: Sequence[int], span: Span) -> Span:
    if len(depths) == 1:
        return _blocks(span, depths[0])
    merged = _blocks(span, depths[0])
    grown = _conv(merged, 3)
    below = _backbone(depths[1:], (grown[0] // 2, grown[1] // 2))
    return _blocks(_union(merged, _conv(below, 3, stride=2, before=1)), depths[0])


def _residual(backbone: BackboneConfig, span: Span) -> Span:
    # Head, backbone, stem.
    return _conv(_backbone(backbone.depths, _conv(span, 3)), 3)
