"""Which benches a network that is told of its bench can serve: ranges of what it was trained on."""

import itertools
import math
from collections.abc import Mapping, Sequence

from data_gen.bench_ranges import BenchRanges, bench_scene, nominal_lamp_rad
from nets.flat_light import window_of
from nets.scene_match import differences, on_grid_of, train_command
from nets.seen_scene import SeenScene
from nets.told import bench_values, light_of, told_parameters
from warp_caustics.errors import MismatchError
from warp_caustics.scene import Scene

MOST_ASIDE = 0.05
"""Of the plate's width that the window may lie beside the plate's image: what it does not show is not known."""
BEYOND = 0.01
"""How far beyond a range a bench may be, in its parameter's scale."""
BEYOND_INDEX = 0.1
"""The same of the index: 1 % of n - 1, by which heights are scaled anyway. Brings soda-lime glass in."""

Ranges = Mapping[str, Sequence[float]]
"""Lowest and highest value by parameter of :mod:`nets.told`; ``light`` is the tangent of the light's angle aside."""


def family_of(scene: Scene, bench: BenchRanges, scene_share: float = 0.0) -> dict[str, list[float]]:
    """Ranges of the parameters of benches.

    Args:
        scene: that the ranges of benches are about.
        bench: their ranges.
        scene_share: whether samples on the scene itself were among them.
    """
    ranges = bench.set_up
    near, far = ranges.lamp_distance_m or (scene.light_distance_m, scene.light_distance_m)
    lamps = ranges.lamp_half_angle_rad or (nominal_lamp_rad(scene),) * 2
    ends = itertools.product(
        ranges.gap_offset_m, ranges.base_offset_m, ranges.index_offset, ranges.dispersion_scale, (near, far), lamps
    )
    scenes = [
        bench_scene(
            scene,
            gap_m=gap - scene.screen_position_m[2],
            base_thickness_m=base + scene.base_thickness_m,
            index_offset=index + scene.index_offset,
            dispersion_scale=dispersion * scene.dispersion_scale,
            is_point_source=float(is_point),
            lamp_distance_m=distance,
            lamp_half_angle_rad=lamp,
            tilt_x_rad=0.0,
            tilt_y_rad=0.0,
            fresnel=0.0,
        )
        for gap, base, index, dispersion, distance, lamp in ends
        for is_point in ranges.kinds_of_light(scene)
    ]
    scenes += [scene] * (scene_share > 0)
    columns = zip(*(bench_values(each) for each in scenes), strict=True)
    names = [row.name for row in told_parameters(scene)]
    found = {name: [min(column), max(column)] for name, column in zip(names, columns, strict=False)}
    del found["light_x"], found["light_y"]
    nominal = math.hypot(*light_of(scene)[0])
    return {**found, "light": [0.0, nominal + math.tan(ranges.tilt_rad[1])]}


def check_family(
    seen: SeenScene,
    trained: Scene,
    family: Ranges,
    name: str,
    kind: str,
    settings: Mapping[str, str] | None = None,
) -> tuple[str, ...]:
    """Refuse a scene that a network was not trained for.

    Args:
        seen: what was measured, as the network sees it; bounds are said in the user's own lengths.
        trained: that the network is made for.
        family: ranges of its training.
        name: of the network's file, for messages.
        kind: of network, for the command that trains one.
        settings: with which such a network is trained, for messages.

    Returns:
        Warnings of its use; none.

    Raises:
        MismatchError: value and nearest bound, and the command that trains for the scene.
    """
    other = [text for key, text in differences(seen.scene, trained).items() if key == "exit_medium"]
    problems = other or _outside(seen, trained, family)
    if not problems:
        return ()
    command = train_command(kind, on_grid_of(seen.user, trained), settings)
    size = "" if seen.scale == 1.0 else f" for a plate of {1e3 * seen.user.plate_size_m[0]:g} mm"
    raise MismatchError(f"{name} is for other benches: {', '.join(problems)}{size}; train one with: {command}")


def _outside(seen: SeenScene, trained: Scene, family: Ranges) -> list[str]:
    scene = seen.scene
    rows = told_parameters(trained)
    values = {row.name: value for row, value in zip(rows, bench_values(scene), strict=False)}
    values["light"] = math.hypot(*light_of(scene)[0])
    scales = {row.name: row.scale for row in rows} | {"light": 0.02}
    found = []
    for key, (low, high) in family.items():
        value = values.get(key, low)
        room = (BEYOND_INDEX if key == "index" else BEYOND) * scales.get(key, 1.0)
        if not low - room <= value <= high + room:
            # In the user's own lengths.
            unit = 1 / seen.scale if key.endswith("_m") and key != "divergence_1_m" else 1.0
            unit = seen.scale if key == "divergence_1_m" else unit
            found.append(_words(key, unit * value, unit * (low if value < low else high)))
    aside = max(abs(at) / size for at, size in zip(window_of(scene), scene.plate_size_m, strict=True))
    if aside > MOST_ASIDE:
        found.append(
            f"the window lies {aside:.1%} of the plate beside its image here, the nearest that is known is "
            f"{MOST_ASIDE:.0%} (scene.screen_position_m)"
        )
    return found


def _words(key: str, value: float, bound: float) -> str:
    if key == "divergence_1_m":
        here, there = (f"{1 / each:.3g} m" if each > 0 else "collimated" for each in (value, bound))
        return f"the lamp's distance is {here} here, the nearest that is known is {there}"
    names = {
        "index": "index of the glass at the middle wavelength",
        "light": "tangent of the light's angle aside",
    }
    what = names.get(key, key)
    if key.startswith("dispersion"):
        what = f"index at wavelength {key.rpartition('_')[2]} less that at the middle one"
    return f"{what} is {value:.4g} here, the nearest that is known is {bound:.4g}"
