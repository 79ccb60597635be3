"""A flat field under a lamp nearby: its light falls off towards the border, and that is not the camera's doing.

Photo over flat field is irradiance over that of a flat plate. Collimated light makes the flat plate's even, L_i; that
of a point source is calculated: 2 % less in the corners of a 5 cm plate than in the middle for a lamp 0.3 m above it.
"""

from typing import TYPE_CHECKING

import numpy as np

from warp_caustics.capture.stage import Work

if TYPE_CHECKING:
    from warp_caustics.scene import Scene
    from warp_caustics.types import FloatArray


def is_near(scene: "Scene") -> bool:
    """Whether light comes from a point."""
    return scene.emission_half_angle_rad > 0


def light_of_flat_plate(scene: "Scene") -> "FloatArray":
    """Irradiance behind a plate without relief, relative to L_i, shape [n_w, m, m]."""
    import torch

    from warp_caustics.simulator import CausticSimulator

    simulator = CausticSimulator(scene, "lattice", device="cpu")
    with torch.no_grad():
        image = simulator(torch.zeros(scene.height_samples, scene.height_samples)).double().numpy()
    level = np.array(scene.radiosity_W_m2)[:, None, None]
    return np.asarray(np.divide(image, level, out=np.ones_like(image), where=level > 0))


def restore_falloff(work: Work, scene: "Scene") -> None:
    """Give back what dividing by the flat field took.

    Args:
        work: after the division, in the window's pixels.
        scene: with a point source.
    """
    light = light_of_flat_plate(scene)
    work.signal = work.signal * light
    least, most = float(light.min()), float(light.max())
    text = f"lamp nearby: a flat plate shows {least:.1%} to {most:.1%} of L_i, which the flat field had divided out"
    work.done("lamp nearby", text, None, least_light=least, most_light=most)
