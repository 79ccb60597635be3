"""``nsfc setup``: which numbers of a set-up an image of a plate fixes, how well, and which trade off."""

import math
from typing import TYPE_CHECKING, Any

import rich_click as click

from cli.console import Console
from cli.options import bench_option, config_options, device_option, json_option, named_number, number
from warp_caustics.device import start_device

if TYPE_CHECKING:
    import torch

    from warp_caustics.scene import Scene
    from warp_caustics.setup.knowledge import Known
    from warp_caustics.setup.model import SetUpModel
    from warp_caustics.setup.unknown_heights import UnknownHeights

SHOWN_UNITS = {"m": (1e6, "um"), "rad": (1e3, "mrad")}
"""Factor and unit for people; others are shown as they are."""

UNSURE = 1e-3
"""Disagreement of two difference steps that is worth a warning."""

SHOWN_WEIGHT = 0.3
"""Part of a direction that is named."""

_SAMPLES = "scene.height_samples"


@click.command(name="setup")
@click.argument("heights", type=click.Path())
@click.option("--camera", metavar="FILE|NAME", help="YAML file of a camera, or careful, ordinary, poor.")
@click.option(
    "--free",
    multiple=True,
    metavar="NAME,...",
    help="Parameters that are not known, such as gap_m,tilt_x_rad,psf_px; all usual ones if not given. Repeatable.",
)
@click.option(
    "--prior",
    "priors",
    multiple=True,
    metavar="NAME=WIDTH",
    help="Standard deviation, e.g. gap_m=5um or 5e-6.",
)
@click.option("--noise", type=number, default=0.01, show_default=True, help="Of a pixel, as part of flat light.")
@click.option("--border", type=int, default=8, show_default=True, metavar="PIXELS", help="Not looked at on all sides.")
@click.option(
    "--unknown-heights",
    default="4",
    show_default=True,
    metavar="N|lines",
    help="N x N splines over the plate, 0 for heights that are known, or every number of the printed lines.",
)
@bench_option
@device_option
@config_options
@json_option
def setup(
    heights: str,
    camera: str | None,
    free: tuple[str, ...],
    priors: tuple[str, ...],
    noise: float,
    border: int,
    unknown_heights: str,
    bench: str | None,
    device: str,
    config_source: str | None,
    settings: tuple[str, ...],
    as_json: bool,
) -> None:
    """Say which numbers of the set-up an image of HEIGHTS fixes, how well, and which trade off.

    HEIGHTS is a map of the relief in metres or a list of printed lines. The set-up is that of the configuration and of
    --camera; the table tells the standard deviation before the image, and after it with heights known and unknown.
    """
    from warp_caustics.errors import InputError

    scene, relief = _plate(heights, config_source, settings, bench)
    if not 0 <= border < scene.image_pixels // 2:
        raise InputError(f"--border {border} leaves nothing of {scene.image_pixels} pixels; use 0 to 16 or so")
    if noise <= 0:
        raise InputError(f"--noise {noise:g} is not above 0: without noise an image tells everything; 0.01 is usual")

    from cli.photo_job import camera_config
    from warp_caustics.setup.information import fisher_information
    from warp_caustics.setup.knowledge import knowledge
    from warp_caustics.setup.model import SetUpModel
    from warp_caustics.setup.set_up import SetUp

    names = [name for given in free for name in given.split(",") if name] or None
    view, before = (
        None if camera is None else camera_config(camera),
        dict(named_number(text, "--prior") for text in priors),
    )
    if bench is not None:
        from warp_caustics.calibration.bench_file import read_bench

        calibrated = read_bench(bench)
        view = calibrated.camera if view is None else view
        before = calibrated.priors() | before
    made = SetUp.of(scene, view, names, priors=before)
    unknown = _unknown(unknown_heights, heights, scene)
    model = SetUpModel(made, device=start_device(device))
    sigma = noise * _flat(model)
    found = model.derivatives(relief)
    inner = (..., slice(border, found.values.shape[-2] - border), slice(border, found.values.shape[-1] - border))
    by_heights = None if unknown is None else model.by_heights(relief, unknown.modes)[inner]
    seen = found._replace(values=found.values[inner])
    told = knowledge(made, seen, sigma, unknown, by_heights)

    console = Console(as_json)
    for name, apart in zip(found.names, found.disagreement.tolist(), strict=True):
        if apart > UNSURE:
            console.warn(
                f"{name}: two steps of a difference disagree by {apart:.1g} (limit {UNSURE:g}), so its image is not "
                "smooth; take a camera with a PSF"
            )
    with_heights = unknown is not None
    heads = (
        "parameter",
        "unit",
        "before",
        "alone",
        "known h",
        "unknown h" if with_heights else "",
        "",
        "trades off with",
    )
    console.line(_row(heads), *(_row(_cells(known, with_heights)) for known in told.parameters))
    at_zero = [known.parameter.name for known in told.parameters if known.verdict == "only its square"]
    if at_zero:
        console.line(
            f"at 0 only the square of {', '.join(at_zero)} counts, of which a derivative tells nothing; give a likely "
            "value, as lamp_half_angle_rad: 0.003 or psf_px: 0.5"
        )
    if told.parameters:
        worst = told.directions[-1]
        parts = [
            f"{'+' if weight > 0 else '-'} {name}"
            for name, weight in zip(found.names, worst.weights.tolist(), strict=True)
            if abs(weight) >= SHOWN_WEIGHT
        ]
        console.line(f"least told {' '.join(parts)}: {worst.remaining:.0%} of what was unknown is left")
    console.record(
        {
            "scene": scene.model_dump(mode="json"),
            "camera": None if view is None else view.model_dump(mode="json"),
            "noise": noise,
            "border_px": border,
            "unknown_heights": unknown_heights,
            "parameters": [_record(known) for known in told.parameters],
            "disagreement": found.disagreement.tolist(),
            "names": list(found.names),
            "fisher_information": fisher_information(seen.values, sigma).tolist(),
            "directions": [{"remaining": d.remaining, "weights": d.weights.tolist()} for d in told.directions],
        }
    )


def _plate(
    heights: str, config_source: str | None, settings: tuple[str, ...], bench: str | None
) -> tuple["Scene", "torch.Tensor"]:
    """The scene, with as many height samples as the map has unless it is told, and the relief."""
    from cli.config import load_config
    from warp_caustics.io.heights import read_heights
    from warp_caustics.prints.line_list import is_line_list
    from warp_caustics.prints.relief_file import read_relief

    config = load_config(config_source, settings, {}, bench=bench)
    if config_source is None and not any(setting.strip().startswith(_SAMPLES) for setting in settings):
        samples = None if is_line_list(heights) else len(read_heights(heights))
        config = load_config(None, settings, {_SAMPLES: samples}, bench=bench)
    scene = config.scene

    import torch

    relief = read_relief(heights, scene.height_samples, scene.plate_size_m, "height map")
    return scene, torch.tensor(relief, dtype=torch.float64)


def _unknown(given: str, heights: str, scene: "Scene") -> "UnknownHeights | None":
    """What is not known about the relief."""
    from warp_caustics.errors import InputError
    from warp_caustics.prints.line_list import is_line_list, read_lines
    from warp_caustics.setup.unknown_heights import line_heights, smooth_heights

    if given == "lines":
        if not is_line_list(heights):
            raise InputError(f"--unknown-heights lines needs a list of lines, not {heights!r}; use --unknown-heights 4")
        return line_heights(scene, read_lines(heights))
    try:
        grid = int(given)
    except ValueError:
        raise click.BadParameter(f"{given!r} is neither a number nor lines", param_hint="--unknown-heights") from None
    return None if grid == 0 else smooth_heights(scene, grid)


def _flat(model: "SetUpModel") -> "torch.Tensor":
    """Light of a flat plate in each channel of an image [W/m^2], shape [C, 1, 1]."""
    import torch

    n = model.setup.nominal_scene.height_samples
    image = model.image(torch.zeros(n, n, dtype=torch.float64))
    rows, columns = (slice(size // 4, size - size // 4) for size in image.shape[1:])
    return image[:, rows, columns].mean((1, 2), keepdim=True)


def _row(cells: tuple[str, ...]) -> str:
    widths = (22, 5, 9, 9, 9, 9, 15)
    return "  ".join([*(f"{c:<{w}}" for c, w in zip(cells[:-1], widths, strict=True)), cells[-1]]).rstrip()


def _cells(known: "Known", with_heights: bool) -> tuple[str, ...]:
    factor, unit = SHOWN_UNITS.get(known.parameter.unit, (1.0, known.parameter.unit))
    numbers = [known.parameter.prior, known.alone, known.together, *([known.with_heights] * with_heights)]
    trades = ", ".join(f"{name} {value:+.2f}" for name, value in known.trades)
    shown = [f"{factor * value:.3g}" for value in numbers] + [""] * (not with_heights)
    return known.parameter.name, unit, *shown, known.verdict, trades


def _record(known: "Known") -> dict[str, Any]:
    def finite(value: float) -> float | None:
        return value if math.isfinite(value) else None

    parameter = known.parameter
    return {
        "name": parameter.name,
        "symbol": parameter.symbol,
        "unit": parameter.unit,
        "meaning": parameter.meaning,
        "value": known.value,
        "prior": parameter.prior,
        "alone": finite(known.alone),
        "together": known.together,
        "with_heights": known.with_heights,
        "verdict": known.verdict,
        "trades": [{"with": name, "correlation": value} for name, value in known.trades],
    }
