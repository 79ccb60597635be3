"""Where the light goes: no loss is silent."""

from typing import Any

import torch

from warp_caustics.chunked import warp_stream
from warp_caustics.kernels.trace import FATE_NAMES
from warp_caustics.simulator import CausticSimulator


def energy_budget(simulator: CausticSimulator, heights: torch.Tensor) -> dict[str, Any]:
    """Account of the light of one simulation, by the fate of each path.

    Traced and summed in float64 whatever the simulator's precision: a float32
    sum of 1.6e7 equal photons comes out 4 % short.

    Args:
        simulator: its scene, photons and device are used.
        heights: relief above the base [m], shape [n, n].

    Returns:
        ``wavelengths_m``; ``emitted_W``, the light that falls on the plate [W]
        (collimated: area times radiosity; point source: what its cone sends
        onto the relief); for each fate of :data:`FATE_NAMES` the fraction of the
        emitted light, one number per wavelength. A fate counts the path's
        centre; the footprint around a path that landed near the border may
        still reach over it. For a point source ``unlit`` counts paths instead
        of light, because they carry none.
    """
    engine = simulator.engine.in_double_precision
    scene = simulator.scene
    channels = scene.n_wavelengths
    light = torch.zeros(channels, len(FATE_NAMES), dtype=torch.float64, device=engine.device)
    paths = torch.zeros_like(light)
    batch = heights.detach().to(torch.float64)[None].contiguous()
    with warp_stream(engine.device):
        coefficients = engine.coefficients(batch)
        for chunk, positions in engine.chunks(1):
            maps = engine.maps(coefficients, chunk, positions)
            _, energies, fates = engine.land(maps, positions)
            for fate in range(len(FATE_NAMES)):
                is_fate = fates[0] == fate
                light[:, fate] += torch.where(is_fate, energies[0], 0.0).sum(1)
                paths[:, fate] += is_fate.sum(1)
    pixel_x, pixel_y = scene.pixel_size_m
    if scene.is_collimated:
        emitted = torch.full((channels,), scene.plate_area_m2 / (pixel_x * pixel_y), dtype=torch.float64)
    else:
        emitted = light.sum(1).cpu()
    fractions = light.cpu() / emitted[:, None]
    unlit = FATE_NAMES.index("unlit")
    fractions[:, unlit] = paths[:, unlit].cpu() / engine.plan.count
    radiosity = torch.tensor(scene.radiosity_W_m2, dtype=torch.float64)
    return {
        "wavelengths_m": list(scene.wavelengths_m),
        "emitted_W": (emitted * radiosity * pixel_x * pixel_y).tolist(),
        **{name: fractions[:, k].tolist() for k, name in enumerate(FATE_NAMES)},
    }
