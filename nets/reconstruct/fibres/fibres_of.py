"""What of ``fibres`` the lines of one image need to know."""

from typing import Protocol

import torch

from nets.reconstruct.direct import Direct
from nets.reconstruct.fibres.options import FibresOptions
from nets.reconstruct.refinement import Refinement
from warp_caustics.scene import Scene


class FibresOf(Protocol):
    """The method: its options, network and device, and what it looks for."""

    name: str
    options: FibresOptions
    network: Direct
    device: torch.device
    scene: Scene
    refinement: Refinement
    finds_bench: bool
    takes_bench_as_told: bool
    finds_section: bool
