"""Around every method with networks: the image as a network knows it, and the record of what came out."""

from collections.abc import Iterator
from typing import Any

import torch

from nets.encoding import flat_irradiance
from warp_caustics.reconstruct.base import CausticImage, Reconstruction, StopReason
from warp_caustics.reconstruct.exposure import exposure_warning
from warp_caustics.reconstruct.result import Resimulation, make_result
from warp_caustics.reconstruct.seen_camera.aligned_channels import repaired
from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray

TRAINED_EXPOSURE_ERROR = 0.05
"""Deviations that networks are trained with."""

UNKNOWN_RESIDUAL = 0.4
"""Own fields of Tab. 3 end below 0.3; more means that the network does not know such images."""


def network_image(image: CausticImage, scene: Scene, trained: Scene, device: torch.device) -> torch.Tensor:
    """The image in the brightness that a network knows, shape [n_w, m, m] [W/m^2], float32.

    Pixels that do not count (saturated, dead) take the mean of their neighbours that do, or stay if brighter.

    Args:
        image: what was measured.
        scene: of the measurement.
        trained: scene of the network.
        device: where to put it.
    """
    measured = torch.as_tensor(repaired(image), dtype=torch.float32, device=device)
    return measured * (flat_irradiance(trained) / flat_irradiance(scene)).to(device)


def network_result(
    method: str,
    resimulation: Resimulation,
    heights: FloatArray,
    *,
    reason: StopReason,
    counters: dict[str, Any],
    warnings: list[str],
    **record: Any,
) -> Reconstruction:
    """The record of a method with networks: :func:`~warp_caustics.reconstruct.result.make_result`, exposure and advice.

    Args:
        method: its name.
        resimulation: of the measured image.
        heights: result [m], shape [n, n].
        reason: why it ended.
        counters: what happened.
        warnings: for the user.
        record: the rest of it.
    """

    def advice(residual: float) -> Iterator[str]:
        if residual > UNKNOWN_RESIDUAL and reason != "interrupted":
            yield (
                f"the result leaves {residual:.0%} of the image unexplained, printed reliefs as in training leave less "
                f"than {UNKNOWN_RESIDUAL:.0%}; check scene and calibration frames, or try --method refine"
            )
        told = exposure_warning(resimulation.exposure)
        if told is not None and told not in warnings:
            yield told

    counters = counters | {"exposure": resimulation.exposure.tolist()}
    return make_result(
        method, resimulation, heights, reason=reason, counters=counters, warnings=warnings, advice=advice, **record
    )
