"""The scene that somebody believes in who is told these numbers: what is simulated beside what is measured."""

import math

from data_gen.bench_ranges import bench_scene
from nets.told import told_parameters
from warp_caustics.materials import melt_index
from warp_caustics.scene import Scene

COLLIMATED = 1e-9
"""Divergence [1/m] below which light is taken for collimated."""


def told_scene(scene: Scene, values: list[float]) -> Scene:
    """A scene of parameters, the reverse of :func:`nets.told.bench_values`.

    The dispersion of the wavelengths is one number of a glass; where they are told apart, the nearest. Fresnel's losses
    are those of ``scene``, and the window lies below the plate's image (:func:`data_gen.bench_ranges.bench_scene`).

    Args:
        scene: gives plate, grids, wavelengths and glass.
        values: P - 2 or P numbers in the order of the table, SI units.
    """
    told = dict(zip((row.name for row in told_parameters(scene)), values, strict=False))
    middle = scene.n_wavelengths // 2
    indices = [melt_index(scene.glass, w) for w in scene.wavelengths_m]
    own = {k: index - indices[middle] for k, index in enumerate(indices) if k != middle}
    norm = sum(each**2 for each in own.values())
    dispersion = sum(told[f"dispersion_{k}"] * each for k, each in own.items()) / norm if norm > 0 else 1.0
    divergence = told["divergence_1_m"]
    is_point = divergence > COLLIMATED
    distance = 1 / divergence if is_point else 0.0
    # Tilts are counted from the scene's own light.
    tilts = []
    for axis, name in enumerate(("light_x", "light_y")):
        if is_point:
            centre = 0.0 if scene.is_collimated else scene.light_position_m[axis]
            tilts.append(math.atan(told[name] + centre * divergence))
        else:
            tilts.append(math.atan(told[name]) - scene.light_tilt_rad[axis])
    return bench_scene(
        scene,
        gap_m=max(0.0, told["gap_m"]),
        base_thickness_m=told["base_thickness_m"],
        index_offset=told["index"] - melt_index(scene.glass, scene.wavelengths_m[middle], 0.0, dispersion),
        dispersion_scale=dispersion,
        is_point_source=float(is_point),
        lamp_distance_m=distance,
        lamp_half_angle_rad=told["lamp_half_angle_rad"],
        tilt_x_rad=tilts[0],
        tilt_y_rad=tilts[1],
        fresnel=float(scene.fresnel),
    )
