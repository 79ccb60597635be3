"""Simulate, compare, and which way the misfit falls: what every descent and every learned updater asks.

Problem: for an objective of the seen image and of the heights,

    E(h) = F(C S(h), h),        grad E = S'(h)^T C^T dF/du + dF/dh,

with S the simulator, C what stands between caustic and measurement (a blur, a mean over wavelengths, nothing), and F a
misfit plus priors. S'(h)^T is the exact adjoint of the simulation; F and C are left to torch, which sees an image and
no photon. One simulation and one adjoint per call, nothing that waits for a GPU unless heights are to be checked.

Heights that are no glass are replaced here too, for the simulator refuses them and a network may answer anything.
"""

from collections.abc import Callable
from typing import NamedTuple

import torch

from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator

DEEPEST_TRENCH = 0.9
"""Share of the plate's thickness that a trench may be deep: a relief must leave some glass. The one limit of descents,
networks and printed designs; ``transport`` keeps to less (see there), and the simulator refuses only holes."""

HIGHEST_RELIEF_M = 0.02
"""Nothing printed is higher [m]: Tab. 3's reliefs stay below half of it. An iteration that diverges does not."""

Objective = Callable[[torch.Tensor, torch.Tensor], torch.Tensor]
"""F: the seen image and the heights [n, n] [m] to one number, differentiable in both."""

Camera = Callable[[torch.Tensor], torch.Tensor]
"""C: the caustic [n_w, m, m] to the image that is compared, linear."""

Denoiser = Callable[[torch.Tensor], torch.Tensor]
"""D: noisy images [B, n_w, m, m] to denoised ones."""


def lowest_height_m(scene: Scene) -> float:
    """Bottom of the deepest trench [m], negative."""
    return -DEEPEST_TRENCH * scene.base_thickness_m


def possible_heights(heights: torch.Tensor, scene: Scene) -> torch.Tensor:
    """Heights [m] of any shape that can be simulated, whatever was said; no number becomes 0."""
    return heights.nan_to_num(0.0).clamp(lowest_height_m(scene), HIGHEST_RELIEF_M)


class DataGradient(NamedTuple):
    """What was found at one relief; tensors on the device, without a graph."""

    value: torch.Tensor
    """F(C S(h), h), shape []."""
    image: torch.Tensor
    """C S(h), in the simulator's units."""
    gradient: torch.Tensor
    """With respect to the heights [1/m], shape [n, n], of their type."""


def data_gradient(
    simulator: CausticSimulator,
    heights: torch.Tensor,
    objective: Objective,
    camera: Camera | None = None,
    *,
    is_checked: bool = True,
) -> DataGradient:
    """Value, image and gradient of an objective at a relief.

    Args:
        simulator: S.
        heights: h [m], shape [n, n], of any floating type on the simulator's device.
        objective: F.
        camera: C; nothing if None.
        is_checked: False where heights are known to be possible, so that a GPU is not waited for and its launches can
            be recorded.

    Raises:
        InputError: heights that cannot be simulated, where they are checked.
    """
    engine, relief = simulator.engine, heights.detach()
    single = relief.to(simulator.dtype)[None].contiguous()
    # Recorded as one, image and gradient share the spline; a call by itself goes through graphs of either.
    coefficients = None
    with torch.no_grad():
        if is_checked:
            image = simulator(single)
        else:
            coefficients = engine.coefficients(single)
            image = engine.image_of(coefficients)
    image.requires_grad_()
    leaf = relief.clone().requires_grad_()
    with torch.enable_grad():
        seen = image[0] if camera is None else camera(image[0])
        value = objective(seen, leaf)
        for_image, for_leaf = torch.autograd.grad(value, (image, leaf), allow_unused=True)
    with torch.no_grad():
        for_image = for_image.contiguous()
        if coefficients is None:
            found = engine.image_adjoint(single, for_image)
        else:
            found = engine.adjoint_of(coefficients, for_image)
        gradient = found[0].to(relief.dtype)
        if for_leaf is not None:
            gradient = gradient + for_leaf
    return DataGradient(value.detach(), seen.detach(), gradient)


@torch.no_grad()
def image_adjoint(simulator: CausticSimulator, heights: torch.Tensor, image: torch.Tensor) -> torch.Tensor:
    """S'(h)^T v, shape [n, n], of an image v [n_w, m, m] at possible heights h [n, n] [m]; nothing is simulated."""
    single = heights.to(simulator.dtype)[None].contiguous()
    return simulator.engine.image_adjoint(single, image[None].contiguous())[0]


@torch.no_grad()
def squares_gradient(
    simulator: CausticSimulator, heights: torch.Tensor, target: torch.Tensor, denoiser: Denoiser | None = None
) -> tuple[torch.Tensor, torch.Tensor]:
    """D(S(h)), and the gradient of E = 1/2 sum_w mean_pixels (D(S(h)) - I)^2: what a learned updater is shown.

    The denoiser D counts as the identity in its derivative, because noise does not depend on the heights. Heights that
    are no glass are replaced first.

    Args:
        simulator: S.
        heights: h [m], shape [B, n, n].
        target: I [W/m^2], shape [B, n_w, m, m].
        denoiser: D; none if None.

    Returns:
        Image [W/m^2], shape of target, and gradient [W^2/m^5], shape of heights.
    """
    relief = possible_heights(heights, simulator.scene).contiguous()
    image = simulator(relief)
    shown = image if denoiser is None else denoiser(image)
    residual = (shown - target) / (target.shape[-1] * target.shape[-2])
    return shown, simulator.engine.image_adjoint(relief, residual.contiguous())
