"""``nsfc capture``: from a photo to irradiance in the scene's window."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rich_click as click

from cli.capture_options import capture_options
from cli.console import Console
from cli.options import bench_option, config_options, json_option

if TYPE_CHECKING:
    from cli.config import Config
    from warp_caustics.capture.shot import Capture


@click.command()
@click.argument("photos", metavar="PHOTO...", nargs=-1, required=True, type=click.Path())
@click.option(
    "-o", "--output", type=click.Path(), required=True, help="Irradiance [W/m^2]: .tif, .exr, .npy, .npz, .h5 or .png."
)
@click.option("--stages", type=click.Path(), help="Picture of all steps (.png, .pdf or .svg).")
@click.option("--mask", type=click.Path(), help="Image of the pixels that hold a measurement (255) or none (0).")
@click.option(
    "--exposure-times", metavar="S,S,...", help="Exposure time of each PHOTO [s], to merge several of one view."
)
@click.option("--force", is_flag=True, help="Replace files that exist.")
@bench_option
@capture_options
@config_options
@json_option
def capture(
    photos: tuple[str, ...],
    output: str,
    stages: str | None,
    mask: str | None,
    exposure_times: str | None,
    force: bool,
    bench: str | None,
    capture: Mapping[str, Any],
    config_source: str | None,
    settings: tuple[str, ...],
    as_json: bool,
) -> int:
    """Turn PHOTO into irradiance in the window of the scene: calibrated, registered and resampled.

    PHOTO may be a capture file (.yaml) that lists the frames of one view with their exposure times. What is written
    is what nsfc reconstruct would see with the same options; there, noise and masked pixels are known as well.
    """
    import numpy as np

    from cli.config import load_config
    from warp_caustics.capture.read import read_capture
    from warp_caustics.capture.settings import capture_files, capture_settings
    from warp_caustics.io.images import write_image

    console = Console(as_json)
    config = load_config(config_source, settings, bench=bench)
    times = _times(photos, exposure_times)
    photo = photos[0] if times is None else None
    options = dict(capture)
    if times is not None:
        options["frames"] = [{"file": name, "exposure_s": time} for name, time in zip(photos, times, strict=True)]
    how = capture_settings(options, photo)
    files = capture_files(photo, how) | ({} if bench is None else {"bench": bench})
    _check_outputs({"--output": output, "--stages": stages, "--mask": mask}, files, force)
    found = read_capture(photo, config.scene, how)
    console.warn(*found.warnings)
    scene = config.scene
    write_image(output, found.irradiance, wavelengths_m=scene.wavelengths_m, pixel_size_m=scene.pixel_size_m)
    if mask is not None:
        write_image(mask, np.where(found.mask, 255, 0).astype(np.uint8))
    if stages is not None:
        from cli.figures import write_figure
        from cli.stages import stages_figure

        write_figure(stages, stages_figure(found.stages, scene.wavelengths_m))
    console.line(f"image      {output}, {' x '.join(map(str, found.irradiance.shape))}")
    console.line(*(f"step       {step}" for step in found.steps))
    noise = ", ".join(f"{value:.3g}" for value in found.noise_std)
    console.line(f"noise      {noise} W/m^2; {1 - found.mask.mean():.2%} of the pixels without measurement")
    console.record(_record(output, found, files, config))
    return 0


def _record(output: str, found: "Capture", files: Mapping[str, str], config: "Config") -> dict[str, Any]:
    from cli.provenance import file_records

    return {
        "output": output,
        "steps": found.steps,
        "figures": {stage.name: stage.figures for stage in found.stages if stage.figures},
        "noise_std_W_m2": found.noise_std,
        "saturated_fraction": found.saturated_fraction,
        "measured_fraction": found.mask.mean(axis=(1, 2)),
        "mean_irradiance_W_m2": found.irradiance.mean(axis=(1, 2)),
        "warnings": found.warnings,
        "inputs": file_records(files),
        "config_fingerprint": config.fingerprint(),
    }


def _times(photos: tuple[str, ...], text: str | None) -> list[float] | None:
    """Exposure times [s], or None for a single photo."""
    from cli.options import number
    from warp_caustics.errors import InputError

    if text is None:
        if len(photos) > 1:
            raise InputError(
                f"{len(photos)} photos: give --exposure-times to merge photos of one view, or call once for each plate"
            )
        return None
    times = [number(part.strip()) for part in text.split(",")]
    if len(times) != len(photos) or len(times) < 2:
        raise InputError(
            f"{len(times)} exposure times for {len(photos)} photos; give two photos or more, one time each"
        )
    return times


def _check_outputs(outputs: Mapping[str, str | None], inputs: Mapping[str, str], force: bool) -> None:
    """Refuse outputs that are an input or each other, exist or have no folder, before anything is computed."""
    from cli.output import check_file
    from warp_caustics.errors import InputError
    from warp_caustics.io.image_format import SUFFIXES

    taken = {os.path.realpath(path): f"the {kind}" for kind, path in inputs.items()}
    for option, path in outputs.items():
        if path is None:
            continue
        real = os.path.realpath(path)
        if real in taken:
            raise InputError(f"{option} {path!r} is {taken[real]}; give another name")
        taken[real] = option
        known = (".png", ".pdf", ".svg") if option == "--stages" else tuple(SUFFIXES)
        if Path(path).suffix.lower() not in known:
            raise InputError(f"suffix of {option} {path!r} is not known; use one of {', '.join(known)}")
        if not Path(real).parent.is_dir():
            raise InputError(f"folder {str(Path(real).parent)!r} does not exist; create it first")
        check_file(path, force, inputs.values(), option)
