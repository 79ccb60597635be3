"""``nsfc calibrate``: the bench from captures of plates that are known."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rich_click as click

from cli.capture_options import capture_options
from cli.console import Console
from cli.options import bench_option, config_options, device_option, integer, json_option, number
from warp_caustics.device import start_device

if TYPE_CHECKING:
    from cli.calibration.shots import Shot
    from warp_caustics.calibration.advice import Advice, LeastTold
    from warp_caustics.calibration.found import Calibration
    from warp_caustics.calibration.view import View
    from warp_caustics.scene import Scene

MOST_ADVICE = 3
"""Lines of it in the terminal; the page has all."""


@click.command()
@click.argument("captures", metavar="CAPTURE...", nargs=-1, required=True, type=click.Path())
@click.option(
    "--plate",
    "plates",
    multiple=True,
    metavar="flat|FILE",
    help="What CAPTURE shows, once for each in their order: flat, a lens or wedge (.yaml), a height map, or a "
    "printed design.",
)
@click.option("-o", "--output", type=click.Path(), required=True, help="Folder for bench.yaml and the page.")
@click.option(
    "--tolerance",
    "tolerances",
    multiple=True,
    metavar="NAME=WIDTH",
    help="Standard deviation of a plate's height_scale, width_scale, shift_x_m, shift_y_m or turn_rad. Repeatable.",
)
@click.option(
    "--camera", metavar="FILE|NAME", help="What is believed of the camera: YAML file, or careful, ordinary, poor."
)
@click.option(
    "--free",
    multiple=True,
    metavar="NAME,...",
    help="Parameters to look for, such as gap_m,tilt_x_rad,psf_px; all usual ones if not given. Repeatable.",
)
@click.option(
    "--prior",
    "priors",
    multiple=True,
    metavar="NAME=WIDTH",
    help="Standard deviation, e.g. gap_m=5um or 5e-6.",
)
@click.option("--noise", type=number, help="Of a pixel, as part of flat light. [default: seen in each capture]")
@click.option(
    "--border", type=integer, default="8", show_default=True, metavar="PIXELS", help="Not looked at on all sides."
)
@click.option(
    "--finest",
    type=integer,
    default="256",
    show_default=True,
    metavar="PIXELS",
    help="Per side of the last level, at most.",
)
@click.option(
    "--iterations", type=integer, default="8", show_default=True, help="Of the descent on the last level, at most."
)
@click.option("--advice/--no-advice", default=True, show_default=True, help="Say what to measure or photograph next.")
@click.option("--force", is_flag=True, help="Replace an earlier result.")
@bench_option
@capture_options
@device_option
@config_options
@json_option
def calibrate(
    captures: tuple[str, ...],
    plates: tuple[str, ...],
    output: str,
    tolerances: tuple[str, ...],
    camera: str | None,
    free: tuple[str, ...],
    priors: tuple[str, ...],
    noise: float | None,
    border: int,
    finest: int,
    iterations: int,
    advice: bool,
    force: bool,
    bench: str | None,
    capture: Mapping[str, Any],
    device: str,
    config_source: str | None,
    settings: tuple[str, ...],
    as_json: bool,
) -> int:
    """Find the bench from CAPTURE, one or more photos of plates that are known.

    A plate without relief tells lamp and uneven light, a lens or a print the rest. CAPTURE may be a list (.yaml) of
    captures with their
    plates and frames. OUTPUT then holds bench.yaml, which every command takes with --bench, and report.html.
    """
    from cli.calibration.files import CALIBRATION, write_calibration
    from cli.calibration.shots import given_shots, named_numbers
    from cli.config import load_config
    from cli.output import check_target, result_folder
    from cli.provenance import file_records
    from cli.shipped_files import config_files
    from warp_caustics.errors import InputError

    if noise is not None and not noise > 0:
        raise InputError(f"--noise {noise:g} is not above 0; 0.01 is usual")
    if finest < 32 or iterations < 1:
        raise InputError(f"--finest {finest} or --iterations {iterations} is too small; use 32 pixels and 1, or more")
    console = Console(as_json)
    shots = given_shots(captures, plates, named_numbers(tolerances, "--tolerance"), capture)
    scene = load_config(config_source, settings, {}, bench=bench).scene
    believed, widths = _believed(camera, bench, named_numbers(priors, "--prior"))
    files: dict[str, str] = {f"{shot.name}, {role}": path for shot in shots for role, path in shot.files.items()}
    inputs: list[str | Path] = [
        *captures,
        *files.values(),
        *config_files(config_source),
        *([] if bench is None else [bench]),
    ]
    target = check_target(output, force, CALIBRATION, inputs)
    names = [name for given in free for name in given.split(",") if name] or None
    scene = _with_samples(scene, shots, settings)
    views = [_view(shot, scene, noise, console) for shot in shots]

    from warp_caustics.calibration.calibrate import calibrate as calibrated

    def progress(level: str, iteration: int, cost: float) -> None:
        if not as_json:
            click.echo(f"{level}, iteration {iteration}: {cost:.6g}", err=True)

    started = start_device(device)
    found = calibrated(
        scene, believed, views, free=names, priors=widths, finest=finest, border_px=border, iterations=iterations,
        device=started, progress=progress,
    )  # fmt: skip
    told = _told(found, advice, started)
    console.warn(*found.warnings)
    record = _record(found, told, output, file_records(files))
    with result_folder(target, force, CALIBRATION) as folder:
        write_calibration(folder, found, told, record)
    console.line(*_lines(found, told, output))
    console.record(record)
    return 0


def _believed(camera: str | None, bench: str | None, priors: dict[str, float]) -> tuple[Any, dict[str, float]]:
    """The camera and how well the bench is known before: of an earlier calibration, unless it is said otherwise."""
    from cli.photo_job import camera_config

    if bench is None:
        return (None if camera is None else camera_config(camera)), priors
    from warp_caustics.calibration.bench_file import read_bench

    before = read_bench(bench)
    return (before.camera if camera is None else camera_config(camera)), before.priors() | priors


def _with_samples(scene: "Scene", shots: "list[Shot]", settings: tuple[str, ...]) -> "Scene":
    """The scene with as many samples as the height maps have, unless that was said.

    Raises:
        InputError: maps of two sizes.
    """
    from warp_caustics.errors import InputError
    from warp_caustics.io.heights import read_heights
    from warp_caustics.prints.line_list import is_line_list
    from warp_caustics.scene import Scene

    maps = {
        shot.plate: len(read_heights(shot.plate))
        for shot in shots
        if shot.plate != "flat" and not is_line_list(shot.plate)
    }
    sizes = set(maps.values())
    if len(sizes) > 1:
        raise InputError(f"height maps have {sorted(sizes)} samples; resample them to one number")
    if not sizes or any(setting.strip().startswith("scene.height_samples") for setting in settings):
        return scene
    return Scene.model_validate(scene.model_dump() | {"height_samples": sizes.pop()})


def _view(shot: "Shot", scene: "Scene", noise: float | None, console: Console) -> "View":
    """A capture, calibrated as for a reconstruction."""
    import numpy as np

    from warp_caustics.calibration.view import View
    from warp_caustics.capture.read import read_capture
    from warp_caustics.errors import InputError

    plate = shot.known_plate()
    capture = read_capture(shot.image, scene, shot.settings)
    is_divided = shot.settings.flat is not None
    # Without a flat frame uneven light is looked for, and the warning that it stays does not hold.
    console.warn(*(f"{shot.name}: {line}" for line in capture.warnings if is_divided or "no flat field" not in line))
    level = np.maximum(np.array(scene.radiosity_W_m2), 1e-12)
    seen = capture.noise_std if noise is None else noise * level
    if not (np.isfinite(seen) & (seen > 0)).all():
        raise InputError(f"{shot.image}: its noise cannot be told from it; give --noise 0.01, or what the camera has")
    return View(shot.name, plate, capture.irradiance.astype(np.float64), np.asarray(seen), capture.mask, is_divided)


def _told(found: "Calibration", wanted: bool, device: str) -> "tuple[LeastTold, list[Advice]]":
    from warp_caustics.calibration.advice import advice, least_told

    return least_told(found), advice(found, device=device) if wanted else []


def _lines(found: "Calibration", told: "tuple[LeastTold, list[Advice]]", output: str) -> list[str]:
    from cli.calibration.files import least_words, shown

    rows = [shown(item) for item in found.bench]
    lines = [f"{'number':<22} {'believed':>10} {'+-':>8} {'found':>12} {'+-':>9}  unit   verdict"]
    lines += [
        f"{row['name']:<22} {row['before']:>10} {row['prior']:>8} {row['value']:>12} {row['sigma']:>9}  "
        f"{row['unit']:<5}  "
        f"{row['verdict']}"
        for row in rows
    ]
    for fit in found.fits:
        worst = float(fit.misfit.max())
        lines.append(
            f"{fit.view.name}: {fit.explained:.1%} of the difference explained, {worst:.2f} times the noise is left"
        )
    least, advised = told
    lines.append(f"least told {least_words(least)}")
    lines += [f"next       {item.what}: {item.left:.0%} of that would be left" for item in advised[:MOST_ADVICE]]
    return [*lines, f"result     {output}: bench.yaml, report.html"]


def _record(
    found: "Calibration", told: "tuple[LeastTold, list[Advice]]", output: str, inputs: Mapping[str, Any]
) -> dict[str, Any]:
    from cli.provenance import now, versions

    least, advised = told
    return {
        "output": output,
        "parameters": [
            {
                "name": f.parameter.name, "capture": f.view, "unit": f.parameter.unit, "value": f.value,
                "sigma": f.sigma, "noise_sigma": f.noise_sigma, "before": f.before,
                "prior": f.parameter.prior, "left": f.remaining, "verdict": f.verdict,
            }
            for f in found.found
        ],
        "covariance": found.covariance.tolist(),
        "captures": [
            {
                "name": fit.view.name, "plate": fit.view.plate.name, "kind": fit.view.plate.kind,
                "is_divided": fit.view.is_divided, "misfit": fit.misfit.tolist(), "explained": fit.explained,
                "noise_W_m2": fit.view.noise.tolist(),
            }
            for fit in found.fits
        ],
        "least_told": {"remaining": least.remaining, "parts": dict(least.parts)},
        "advice": [
            {"what": item.what, "left": item.left, "most": item.most, "sigma": item.sigma} for item in advised
        ],
        "is_converged": found.is_converged,
        "iterations": found.iterations,
        "warnings": list(found.warnings),
        "inputs": inputs,
        "versions": versions(),
        "created": now(),
    }  # fmt: skip
