"""The learned parts: the paper's family of networks, this project's own, and their weights.

These names are the public ones, imported on first use. :func:`create` makes
every reconstruction method by its name, those without networks too.
"""

from typing import TYPE_CHECKING

from warp_caustics.front_door import front_door

if TYPE_CHECKING:
    from nets.architecture import build as build
    from nets.reconstruct.methods import ALL_METHODS as ALL_METHODS
    from nets.reconstruct.methods import create as create
    from nets.shipped import find_network as find_network
    from nets.weights import load_weights as load_weights
    from nets.weights import save_weights as save_weights
    from nets.weights import weights_info as weights_info

_HOMES = {
    "ALL_METHODS": "nets.reconstruct.methods",
    "build": "nets.architecture",
    "create": "nets.reconstruct.methods",
    "find_network": "nets.shipped",
    "load_weights": "nets.weights",
    "save_weights": "nets.weights",
    "weights_info": "nets.weights",
}

__all__ = [*_HOMES]

__getattr__ = front_door(__name__, _HOMES)
