"""``nsfc plan``: what a fibre will show in a set-up, before anything is printed."""

import math
from typing import TYPE_CHECKING

import rich_click as click

from cli.console import Console
from cli.options import bench_option, config_options, json_option, length

if TYPE_CHECKING:
    from warp_caustics.scene import Scene


@click.command()
@click.option("--fibre-height", type=length, required=True, metavar="LENGTH", help="Of a printed line, e.g. 0.1mm.")
@click.option("--fibre-width", type=length, required=True, metavar="LENGTH", help="Full width of a line, e.g. 2mm.")
@click.option("--screen-distance", type=length, metavar="LENGTH", help="Below the plate; the scene's own if not given.")
@click.option("--lamp-size", type=length, metavar="LENGTH", help="Diameter of what shines; with it the blur is told.")
@click.option("--focal-length", type=length, metavar="LENGTH", help="Of the collimator with the lamp in its focus.")
@click.option(
    "--lamp-distance", type=length, metavar="LENGTH", help="Without a collimator: of the lamp, above the plate."
)
@bench_option
@config_options
@json_option
def plan(
    fibre_height: float,
    fibre_width: float,
    screen_distance: float | None,
    lamp_size: float | None,
    focal_length: float | None,
    lamp_distance: float | None,
    bench: str | None,
    config_source: str | None,
    settings: tuple[str, ...],
    as_json: bool,
) -> None:
    """Say what a printed line will show: will its caustic fold, how sharp, how large, how bright; and what to change.

    Lengths as 2mm, 100um or 0.5m. Plate, glass, wavelengths and pixels are those of the configuration.
    """
    if focal_length is not None and lamp_distance is not None:
        raise click.UsageError("give --focal-length (collimated light) or --lamp-distance (none), not both")
    if lamp_size is not None and focal_length is None and lamp_distance is None:
        raise click.UsageError("--lamp-size needs --focal-length of the collimator, or --lamp-distance without one")
    from dataclasses import asdict

    from cli.config import load_config
    from warp_caustics.plan import Fibre, told_m
    from warp_caustics.plan import plan as planned

    scene = _placed(load_config(config_source, settings, bench=bench).scene, screen_distance, lamp_distance)
    away_m = focal_length if focal_length is not None else lamp_distance
    half_angle = math.atan(lamp_size / 2 / away_m) if lamp_size is not None and away_m else 0.0
    fibre = Fibre(fibre_width, fibre_height)
    found = planned(scene, fibre, half_angle)

    console = Console(as_json)
    console.line(
        f"fibre      {told_m(fibre.height_m)} high, {told_m(fibre.width_m)} wide",
        f"screen     {told_m(-scene.screen_position_m[2])} below a plate of {told_m(scene.base_thickness_m)}, "
        f"{'collimated light' if scene.is_collimated else 'a lamp without collimator'}",
        f"focus      {_focus(found.traced_focus_m)}, {_focus(found.focus_m)} by the formula for gentle slopes",
    )
    if lamp_size is None:
        console.line("lamp       taken for a point: give --lamp-size and --focal-length to know its blur")
    for advice in found.advice:
        if advice.topic != "lamp" or lamp_size is not None:
            console.line(f"{advice.topic:<10} {advice.rating}: {advice.text}")
    console.line(f"settings   {' '.join(_settings(scene))}")
    console.record({"scene": scene.model_dump(mode="json"), "lamp_half_angle_rad": half_angle, **asdict(found)})


def _placed(scene: "Scene", screen_m: float | None, lamp_m: float | None) -> "Scene":
    """The scene with screen and lamp where the options put them."""
    from warp_caustics.errors import InputError
    from warp_caustics.scene import Scene

    tree = scene.model_dump()
    if screen_m is not None:
        x, y, _ = scene.screen_position_m
        tree["screen_position_m"] = (x, y, -screen_m)
    if lamp_m is not None:
        if lamp_m <= 0:
            raise InputError(f"--lamp-distance {lamp_m:g} m is not above 0; measure from the plate's top")
        tree["light_position_m"] = (0.0, 0.0, scene.base_thickness_m + lamp_m)
        # A cone that lights the plate's corners.
        tree["emission_half_angle_rad"] = math.ceil(1e3 * math.atan(math.hypot(*scene.plate_size_m) / 2 / lamp_m)) / 1e3
    from cli.config import validated

    return validated(Scene, tree)


def _focus(distance_m: float) -> str:
    from warp_caustics.plan import told_m

    if math.isinf(distance_m):
        return "nowhere"
    return f"{told_m(distance_m)} below the plate" if distance_m > 0 else "within the plate"


def _settings(scene: "Scene") -> list[str]:
    """What to add to other commands, as one would type it."""
    values = {"screen_position_m": list(scene.screen_position_m)}
    if not scene.is_collimated:
        values["light_position_m"] = list(scene.light_position_m)
    found = [f"--set scene.{key}='{value}'" for key, value in values.items()]
    if not scene.is_collimated:
        found.append(f"--set scene.emission_half_angle_rad={scene.emission_half_angle_rad:g}")
    return found
