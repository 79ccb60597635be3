"""Which heights a network may be taken at its word for."""

import torch

from warp_caustics.reconstruct.base import DEEPEST_FRACTION
from warp_caustics.scene import Scene

HIGHEST_M = 0.02
"""Nothing printed is higher: Tab. 3's reliefs stay below half of it. An iteration that diverges does not."""


def possible_heights(heights: torch.Tensor, scene: Scene) -> torch.Tensor:
    """Heights [m] of any shape that can be simulated, whatever a network said."""
    return heights.nan_to_num(0.0).clamp(-DEEPEST_FRACTION * scene.base_thickness_m, HIGHEST_M)
