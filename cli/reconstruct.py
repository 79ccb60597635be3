"""``nsfc reconstruct``: from one caustic image to the printed heights."""

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rich_click as click

from cli.console import Console, json_text
from cli.options import config_options, device_option, integer, json_option, number, start_device

if TYPE_CHECKING:
    from cli.config import Config
    from warp_caustics.io.capture import Capture
    from warp_caustics.reconstruct.base import (
        CausticImage,
        FloatArray,
        ProgressCallback,
        Reconstruction,
        Reconstructor,
    )
    from warp_caustics.scene import Scene

EXIT_INTERRUPTED = 130

TRANSPORT = "transport"
"""Value of --initial that is no file; a file of that name is ./transport."""


@click.command()
@click.argument("image", type=click.Path())
@click.option(
    "-o", "--output", type=click.Path(), required=True, help="Folder for the result; made complete or not at all."
)
@click.option("--method", help="How to reconstruct. [default: refine]")
@click.option("--dark", type=click.Path(), help="Frame of the same camera with the light off.")
@click.option("--flat", type=click.Path(), help="Frame of the same camera with a plate without relief.")
@click.option("--wavelength-order", metavar="NM,NM,...", help="Wavelength of each channel, e.g. 610,530,430.")
@click.option("--transfer", type=click.Choice(["linear", "srgb"]), help="Tone curve of an integer image.")
@click.option("--page", type=integer, help="Page of a TIFF with several, from 0.")
@click.option("--dataset", help="Array in an HDF5 or NPZ file. [default: image]")
@click.option(
    "--initial",
    metavar="FILE|transport",
    help="Height map to start from, or transport: what that method finds. [default: the method's choice]",
)
@click.option("--reference", type=click.Path(), help="True height map; errors are reported against it.")
@click.option("--max-iterations", type=integer, help="Iterations per stage, at most.")
@click.option("--max-time", type=number, metavar="SECONDS", help="Stop after so many seconds.")
@click.option("--seed", type=integer, help="For methods that draw random numbers; refine draws none.")
@click.option("--force", is_flag=True, help="Replace an earlier result.")
@device_option
@config_options
@json_option
def reconstruct(
    image: str,
    output: str,
    method: str | None,
    dark: str | None,
    flat: str | None,
    wavelength_order: str | None,
    transfer: str | None,
    page: int | None,
    dataset: str | None,
    initial: str | None,
    reference: str | None,
    max_iterations: int | None,
    max_time: float | None,
    force: bool,
    seed: int | None,
    device: str,
    config_source: str | None,
    settings: tuple[str, ...],
    as_json: bool,
) -> int:
    """Recover the height field behind IMAGE, one caustic (.tif, .png, .exr, .npy, .npz or .h5).

    Ctrl-C ends the iteration early; the best result so far is still written.
    """
    from cli.config import load_config
    from cli.results import check_target, result_folder

    console = Console(as_json)
    target = check_target(output, force)
    config = load_config(
        config_source,
        settings,
        {
            "simulation.seed": seed,
            "reconstruction.method": method,
            "reconstruction.options.max_iterations": max_iterations,
            "reconstruction.options.max_time_s": max_time,
        },
    )
    from_transport = initial == TRANSPORT
    start = None if from_transport else initial
    files = {"image": image, "dark": dark, "flat": flat, "initial": start, "reference": reference}
    inputs = read_inputs(
        {kind: path for kind, path in files.items() if path is not None},
        config.scene,
        page=page,
        dataset=dataset,
        transfer=transfer,
        wavelength_order=wavelength_order,
    )
    for warning in inputs.capture.warnings:
        console.warn(warning)
    device = start_device(device)
    reconstructor = make_method(config, device)
    with result_folder(target, force) as folder:
        with console.progress() as progress:
            if from_transport:
                result, inputs = reconstruct_from_transport(reconstructor, inputs, config.scene, device, progress)
            else:
                result = reconstructor.reconstruct(inputs.caustic, initial=inputs.initial, progress=progress)
        record = result_record(result, inputs, config)
        write_results(folder, result, inputs, config, record)
    for warning in result.warnings:
        console.warn(warning)
    for line in summary(output, result, record):
        console.line(line)
    console.record(record)
    if result.stop_reason == "interrupted":
        click.echo(f"interrupted; the best result so far is in {output}", err=True)
        return EXIT_INTERRUPTED
    return 0


@dataclass(frozen=True, eq=False)
class Inputs:
    """All that was read.

    Attributes:
        capture: calibrated image.
        initial: relief to start from [m], shape [n, n].
        reference: true relief [m], shape [n, n].
        files: path and sha256 of each file, by its role.
    """

    capture: "Capture"
    initial: "FloatArray | None"
    reference: "FloatArray | None"
    files: Mapping[str, Mapping[str, str]]

    @property
    def caustic(self) -> "CausticImage":
        """The image as methods take it."""
        import numpy as np

        from warp_caustics.reconstruct.base import CausticImage

        noise = self.capture.noise_std
        is_known = bool(np.isfinite(noise).all())
        return CausticImage(self.capture.irradiance, noise if is_known else None, self.capture.mask)


def read_inputs(
    files: Mapping[str, str],
    scene: "Scene",
    *,
    page: int | None = None,
    dataset: str | None = None,
    transfer: str | None = None,
    wavelength_order: str | None = None,
) -> Inputs:
    """Read and check everything a reconstruction needs, before any of it is computed.

    Args:
        files: paths by role: image, and where given dark, flat, initial, reference.
        scene: what they must fit.
        page: page of the image.
        dataset: array within the image's file.
        transfer: tone curve of image, dark and flat.
        wavelength_order: wavelengths of the channels [nm].
    """
    from warp_caustics.io.capture import capture_to_irradiance
    from warp_caustics.io.images import read_image

    frames = {kind: read_image(files[kind], transfer=transfer) for kind in ("dark", "flat") if kind in files}
    capture = capture_to_irradiance(
        read_image(files["image"], page=page, dataset=dataset, transfer=transfer),
        scene=scene,
        dark=frames.get("dark"),
        flat=frames.get("flat"),
        wavelength_order=wavelength_order,
    )
    return Inputs(
        capture=capture,
        initial=_read_relief(files, "initial", scene),
        reference=_read_relief(files, "reference", scene),
        files={kind: {"path": path, "sha256": _sha256(path)} for kind, path in files.items()},
    )


def _read_relief(files: Mapping[str, str], kind: str, scene: "Scene") -> "FloatArray | None":
    from warp_caustics.errors import MismatchError
    from warp_caustics.io.heights import read_heights

    if kind not in files:
        return None
    heights = read_heights(files[kind])
    n = scene.height_samples
    if heights.shape != (n, n):
        raise MismatchError(
            f"{kind} {files[kind]!r} has shape {list(heights.shape)}, the scene [{n}, {n}]; "
            f"resample it, or --set scene.height_samples={len(heights)}"
        )
    return heights


def _sha256(path: str) -> str:
    import hashlib

    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def make_method(config: "Config", device: str) -> "Reconstructor":
    """The configured method for the configured scene."""
    from warp_caustics.reconstruct import methods

    chosen: Reconstructor = methods.create(
        config.reconstruction.method, config.scene, device=device, **config.reconstruction.options
    )
    return chosen


def reconstruct_from_transport(
    method: "Reconstructor", inputs: Inputs, scene: "Scene", device: str, progress: "ProgressCallback | None"
) -> tuple["Reconstruction", Inputs]:
    """Result of a method that starts where transport ends, and the inputs with that start.

    Ctrl-C before the method starts makes what transport found so far the result.
    """
    from warp_caustics.reconstruct.transport import transport_initial, with_initial

    start = transport_initial(scene, inputs.caustic, device, progress)
    inputs = replace(inputs, initial=start.heights_m)
    if start.stop_reason == "interrupted":
        return start, inputs
    return with_initial(method.reconstruct(inputs.caustic, initial=start.heights_m, progress=progress), start), inputs


def result_record(result: "Reconstruction", inputs: Inputs, config: "Config") -> dict[str, Any]:
    """Everything about a result but its arrays."""
    from cli.env import versions
    from warp_caustics.metrics import height_errors

    reference, plate = inputs.reference, config.scene.plate_size_m
    return {
        "method": result.method,
        "residual": result.residual,
        "stop_reason": result.stop_reason,
        "iterations": len(result.history),
        "errors": None if reference is None else height_errors(result.heights_m, reference, plate),
        "initial_errors": None
        if reference is None or inputs.initial is None
        else height_errors(inputs.initial, reference, plate),
        "height_range_m": [result.heights_m.min(), result.heights_m.max()],
        "timings_s": result.timings_s,
        "counters": result.counters,
        "settings": result.settings,
        "warnings": [*inputs.capture.warnings, *result.warnings],
        "inputs": inputs.files,
        "calibration": {
            "steps": inputs.capture.steps,
            "noise_std_W_m2": inputs.capture.noise_std,
            "saturated_fraction": inputs.capture.saturated_fraction,
        },
        "config_fingerprint": config.fingerprint(),
        "versions": versions(),
        "created": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        "history": result.history,
    }


def write_results(
    folder: Path, result: "Reconstruction", inputs: Inputs, config: "Config", record: Mapping[str, Any]
) -> None:
    """Write the files of a result (``cli.results.FILES``) into a folder."""
    from cli.config import dump_config
    from cli.overview import overview_figure, write_overview
    from warp_caustics.io.atomic import atomic_path
    from warp_caustics.io.heights import write_heights
    from warp_caustics.io.mesh import height_field_mesh, write_mesh

    scene = config.scene
    write_heights(folder / "height.npy", result.heights_m)
    write_heights(folder / "height.tif", result.heights_m)
    write_mesh(folder / "surface.stl", height_field_mesh(result.heights_m, scene.plate_size_m, scene.base_thickness_m))
    figure = overview_figure(
        scene=scene,
        measured=inputs.capture.irradiance,
        simulated=result.image,
        heights_m=result.heights_m,
        caption=f"{result.method}: {'; '.join(_figures(result, record))}",
    )
    write_overview(folder / "overview.png", figure)
    for name, text in (("config.resolved.yaml", dump_config(config)), ("result.json", json_text(record) + "\n")):
        with atomic_path(folder / name) as path:
            path.write_text(text, encoding="utf-8")


def _figures(result: "Reconstruction", record: Mapping[str, Any]) -> list[str]:
    figures = [f"image residual {result.residual:.3g}"]
    if record["errors"]:
        errors = record["errors"]
        figures.append(f"height RMSE {errors['rmse_um']:.3g} um (flat guess {errors['reference_rms_um']:.3g} um)")
    return figures


def summary(output: str, result: "Reconstruction", record: Mapping[str, Any]) -> list[str]:
    """A few lines for people."""
    from cli.results import FILES

    low, high = (height * 1e3 for height in record["height_range_m"])
    lines = [
        f"result     {output}: {', '.join(FILES)}",
        f"method     {result.method}, {len(result.history)} iterations, {sum(result.timings_s.values()):.1f} s, "
        f"stopped by {result.stop_reason.replace('_', ' ')}",
        f"residual   {result.residual:.4g} of the image",
        f"heights    {low:.4g} to {high:.4g} mm",
    ]
    errors = record["errors"]
    if errors:
        lines.append(
            f"errors     RMSE {errors['rmse_um']:.4g} um (without the mean {errors['rmse_mean_removed_um']:.4g}), "
            f"95 % within {errors['quantile95_um']:.4g} um; a flat guess has {errors['reference_rms_um']:.4g} um"
        )
    if record["initial_errors"]:
        lines.append(f"start      RMSE {record['initial_errors']['rmse_um']:.4g} um")
    return lines
