"""Light as a screen shows it: a method is not to be judged by images that its own lattice made."""

import torch

from warp_caustics.extrapolated import ExtrapolatedCaustic
from warp_caustics.simulator import CausticSimulator


def light_of(scene, heights):
    """Irradiance [W/m^2], shape [n_w, m, m], of a relief [m], shape [n, n]; without the error of a lattice."""
    relief = torch.as_tensor(heights, dtype=torch.float32)
    return ExtrapolatedCaustic(CausticSimulator(scene, "lattice"), 16)(relief)
