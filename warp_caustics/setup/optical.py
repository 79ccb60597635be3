"""Numbers of plate, light and screen: how they are read from a scene and written into one.

Collimated light and a point source have numbers of their own. Those of collimated light go on to lamps at a finite
distance by the vergence v = 1 / L: above 0 the scene has a point source at the distance L above the plate's top, in
the direction that the tilt says and as large as the half angle says, with the plate's centre as bright as before.
Between parallel light and the limit of far lamps small steps are left, of the second order in the tilt for the lamp's
size, whose disc is level, and of the fourth with ``scene.fresnel``, whose flat plate is that right below the lamp.
"""

import math
from collections.abc import Mapping
from typing import Any

import pydantic

from warp_caustics.errors import InputError
from warp_caustics.scene import (
    MAX_LAMP_HALF_ANGLE_RAD,
    MAX_LENGTH_M,
    MAX_PLATE_M,
    MAX_TILT_RAD,
    Scene,
    validation_lines,
)
from warp_caustics.setup.parameter import Parameter

LARGEST_VERGENCE = 10.0
"""Of light that is meant to be parallel [1/m]: a lamp at 0.1 m."""

LEAST_CONE_RAD = 0.01
"""Half angle by which a far lamp's cone is wider than the plate: its edge must never show."""

STEP_PX = 1e-3
"""How far light moves, about, for the step of a difference [px]: in double precision far above rounding, and far
below a pixel and most footprints."""

_ALWAYS = (
    Parameter("base_thickness_m", "d", "m", 1e-6, MAX_PLATE_M, 3e-5, "plate", "thickness of the base"),
    Parameter("gap_m", "g", "m", 0.0, MAX_LENGTH_M, 5e-5, "screen", "from the plate's bottom to the screen"),
    Parameter("index_offset", "dn", "1", -0.2, 0.2, 1e-3, "plate", "of the index at 587.6 nm"),
    Parameter("dispersion_scale", "k_n", "1", -2.0, 4.0, 0.02, "plate", "dispersion over that of the catalogue"),
    Parameter("screen_x_m", "S_x", "m", -MAX_PLATE_M, MAX_PLATE_M, 1e-4, "screen", "middle of the window along x"),
    Parameter("screen_y_m", "S_y", "m", -MAX_PLATE_M, MAX_PLATE_M, 1e-4, "screen", "middle of the window along y"),
)
_COLLIMATED = (
    Parameter("tilt_x_rad", "a_x", "rad", -MAX_TILT_RAD, MAX_TILT_RAD, 5e-3, "light", "of the light towards x"),
    Parameter("tilt_y_rad", "a_y", "rad", -MAX_TILT_RAD, MAX_TILT_RAD, 5e-3, "light", "of the light towards y"),
    Parameter("vergence_per_m", "v", "1/m", 0.0, LARGEST_VERGENCE, 0.1, "light", "1 / distance of the lamp's image"),
    Parameter(
        "lamp_half_angle_rad",
        "theta",
        "rad",
        0.0,
        MAX_LAMP_HALF_ANGLE_RAD,
        3e-3,
        "light",
        "half the lamp's extent",
        is_squared=True,
    ),
)
_POINT = (
    Parameter("lamp_x_m", "L_x", "m", -MAX_LENGTH_M, MAX_LENGTH_M, 5e-3, "light", "place of the lamp along x"),
    Parameter("lamp_y_m", "L_y", "m", -MAX_LENGTH_M, MAX_LENGTH_M, 5e-3, "light", "place of the lamp along y"),
    Parameter("lamp_distance_m", "L", "m", 1e-3, MAX_LENGTH_M, 1e-2, "light", "of the lamp from the plate's top"),
    Parameter("lamp_radius_m", "r", "m", 0.0, MAX_PLATE_M, 5e-4, "light", "of the lamp's disc", is_squared=True),
)


def optical_parameters(scene: Scene) -> tuple[Parameter, ...]:
    """Parameters of plate, light and screen that a scene has."""
    return (*_ALWAYS, *(_COLLIMATED if scene.is_collimated else _POINT))


def optical_values(scene: Scene, nominal: Scene) -> dict[str, float]:
    """Values of all optical parameters of a nominal scene, read from another of its kind.

    Raises:
        InputError: a scene with collimated light where the nominal one has a point source.
    """
    values = {
        "base_thickness_m": scene.base_thickness_m,
        "gap_m": abs(scene.screen_position_m[2]),
        "index_offset": scene.index_offset,
        "dispersion_scale": scene.dispersion_scale,
        "screen_x_m": scene.screen_position_m[0],
        "screen_y_m": scene.screen_position_m[1],
    }
    x, y, _ = scene.light_position_m
    away = scene.light_distance_m
    if not nominal.is_collimated:
        if scene.is_collimated:
            raise InputError(
                "collimated light has no lamp at a distance; take a set-up whose nominal scene is collimated, it has "
                "vergence_per_m"
            )
        return values | {"lamp_x_m": x, "lamp_y_m": y, "lamp_distance_m": away, "lamp_radius_m": scene.lamp_radius_m}
    if scene.is_collimated:
        (tilt_x, tilt_y), vergence, angle = scene.light_tilt_rad, 0.0, scene.lamp_half_angle_rad
    else:
        tilt_x, tilt_y = math.atan(-x / away), math.atan(-y / away)
        vergence, angle = 1 / away, math.asin(min(1.0, scene.lamp_radius_m / away))
    return values | {
        "tilt_x_rad": tilt_x,
        "tilt_y_rad": tilt_y,
        "vergence_per_m": vergence,
        "lamp_half_angle_rad": angle,
    }


def with_optical_values(nominal: Scene, values: Mapping[str, float]) -> Scene:
    """The nominal scene with other values of its optical parameters; those that are not named stay.

    Raises:
        InputError: values that make no scene.
    """
    v = optical_values(nominal, nominal) | dict(values)
    tree: dict[str, Any] = {
        "base_thickness_m": v["base_thickness_m"],
        "screen_position_m": (v["screen_x_m"], v["screen_y_m"], -v["gap_m"]),
        "index_offset": v["index_offset"],
        "dispersion_scale": v["dispersion_scale"],
    }
    if not nominal.is_collimated:
        tree["light_position_m"] = (v["lamp_x_m"], v["lamp_y_m"], v["base_thickness_m"] + v["lamp_distance_m"])
        tree["lamp_radius_m"] = v["lamp_radius_m"]
    elif v["vergence_per_m"] == 0:
        tree["light_tilt_rad"] = (v["tilt_x_rad"], v["tilt_y_rad"])
        tree["lamp_half_angle_rad"] = v["lamp_half_angle_rad"]
    else:
        tree |= _point_source(nominal, v)
    try:
        return Scene.model_validate(nominal.model_dump() | tree)
    except pydantic.ValidationError as error:
        raise InputError("; ".join(validation_lines(error)[:2])) from error


def _point_source(nominal: Scene, v: Mapping[str, float]) -> dict[str, Any]:
    """Fields of a scene whose parallel light comes from a finite distance."""
    away = 1 / v["vergence_per_m"]
    aside = tuple(away * math.tan(v[f"tilt_{axis}_rad"]) for axis in "xy")
    farthest = math.hypot(*(abs(a) + size / 2 for a, size in zip(aside, nominal.plate_size_m, strict=True)))
    # At the distance r = L / cos a the plate's centre has cos^3 a of the light right below the lamp.
    cosine = away / math.hypot(away, *aside)
    return {
        "light_tilt_rad": (0.0, 0.0),
        "lamp_half_angle_rad": 0.0,
        "light_position_m": (-aside[0], -aside[1], v["base_thickness_m"] + away),
        "emission_half_angle_rad": min(math.atan(1.1 * farthest / away) + LEAST_CONE_RAD, 1.55),
        "lamp_radius_m": away * math.sin(v["lamp_half_angle_rad"]),
        "radiosity_W_m2": tuple(light / cosine**3 for light in nominal.radiosity_W_m2),
    }


def optical_steps(scene: Scene) -> dict[str, float]:
    """Steps of differences: what moves light by about :data:`STEP_PX` where the relief is steep or the plate ends."""
    move = STEP_PX * min(scene.pixel_size_m)
    depth = max(
        scene.base_thickness_m / glass - scene.screen_position_m[2] / outside
        for glass, outside in zip(scene.glass_indices, scene.exit_indices, strict=True)
    )
    half = max(scene.plate_size_m) / 2
    away = scene.light_distance_m
    spread = max(scene.glass_indices) - min(scene.glass_indices)
    return {
        "base_thickness_m": move,
        "gap_m": move,
        "index_offset": move / depth,
        "dispersion_scale": move / depth / max(spread, 1e-3),
        "screen_x_m": move,
        "screen_y_m": move,
        "tilt_x_rad": move / depth,
        "tilt_y_rad": move / depth,
        "vergence_per_m": move / depth / half,
        "lamp_half_angle_rad": move / depth,
        "lamp_x_m": move * away / depth,
        "lamp_y_m": move * away / depth,
        "lamp_distance_m": move * away**2 / depth / half,
        "lamp_radius_m": move * away / depth,
    }
