"""The start of a design: optimal transport from even light to the picture, and the relief that does it.

The optimal map folds nowhere, so its relief is smooth and its caustic has no lines that the picture has not.
Unlike ``reconstruct/transport.py`` no part of the plate is bare, and nothing is taken off the heights:
far from the plate a slow bend moves light by whole pixels.
"""

import numpy as np
import torch

from warp_caustics.design.target import resampled
from warp_caustics.reconstruct.transport.integrate_normals import heights_of, integrate_slopes
from warp_caustics.reconstruct.transport.ray_inversion import LightPath
from warp_caustics.reconstruct.transport.transport import GEOMETRY_STEPS, SETTLED_M, grid_points, relief_on_grid
from warp_caustics.reconstruct.transport.transport_map import Report, TransportMap, optimal_transport
from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray


def start_cells(scene: Scene, most: int) -> int:
    """Cells per side of the transport: no more than height samples, pixels or ``most``."""
    return min(most, scene.height_samples, scene.image_pixels)


def carry_even_light(
    target: FloatArray, cells: int, device: torch.device, steps: int, report: Report | None
) -> TransportMap:
    """Optimal map from even light to a target of shape [m, m], on cells x cells squares."""
    block, rest = divmod(len(target), cells)
    coarse = resampled(target, (cells, cells)) if rest else target.reshape(cells, block, cells, block).mean(axis=(1, 3))
    wanted = torch.as_tensor(coarse, device=device)
    return optimal_transport(torch.ones_like(wanted), wanted, max_steps=steps, report=report)


def relief_of(transport: TransportMap, scene: Scene) -> tuple[FloatArray, float]:
    """The relief that sends even light along a map.

    The way through the glass depends on the height, so slopes and heights are found in turn until they settle.

    Returns:
        Heights [m], lowest 0, shape [n, n]; share of the light that cannot be refracted so far.
    """
    cells = transport.displacement_px.shape[1]
    pitch = np.asarray(scene.plate_size_m)[:, None, None] / cells
    points = grid_points(cells, scene)
    centre = np.asarray(scene.screen_position_m[:2])[:, None, None]
    targets = points + centre + transport.displacement_px.cpu().numpy() * pitch
    path = LightPath.of_scene(scene)
    heights: FloatArray = np.zeros((scene.height_samples, scene.height_samples))
    for _ in range(GEOMETRY_STEPS):
        fine, _ = relief_on_grid(heights, cells, scene.plate_size_m)
        slopes, limited = path.slopes_towards(points, fine, targets)
        found = heights_of(integrate_slopes(slopes, scene.plate_size_m), scene.height_samples)
        found = found - found.min()
        change, heights = float(np.abs(found - heights).max()), found
        if change < SETTLED_M:
            break
    return heights, limited
