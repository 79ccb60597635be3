"""``nsfc design``: from a picture to the relief whose caustic it is."""

from typing import TYPE_CHECKING, Any

import rich_click as click

from cli.console import Console
from cli.options import bench_option, config_options, count, device_option, json_option, length, number, seconds
from warp_caustics.device import start_device
from warp_caustics.errors import EXIT_INTERRUPTED

if TYPE_CHECKING:
    from pathlib import Path

    from cli.config import Config
    from warp_caustics.design.designer import Design
    from warp_caustics.io.image_file import ImageFile
    from warp_caustics.types import FloatArray

DEFAULT_SETTINGS = ("scene.height_samples=256",)
"""Where no configuration is named: pictures need finer relief than printed lines."""

CONTACT_M = 1e-3
"""A configuration whose screen is nearer, as that of Tab. 1, is taken to say nothing of the distance of a design."""

PATENTS = (
    "Patents exist on caustic design by optimal transport (EP2963464B1, US10732405B2); read the note in README.md "
    "before a piece is made or sold."
)


@click.command(epilog=PATENTS)
@click.argument("target", type=click.Path())
@click.option(
    "-o", "--output", type=click.Path(), required=True, help="Folder for the result; made complete or not at all."
)
@click.option(
    "--screen-distance",
    type=length,
    metavar="LENGTH",
    help="From the plate's bottom to the screen, e.g. 0.1m or 100mm. [default: the configuration's if above 1mm, else "
    "from 0.1m the least whole centimetre at which the relief stays within --max-height]",
)
@click.option(
    "--plate-size", type=length, metavar="LENGTH", help="Side of the plate and of the picture. [default: 50mm]"
)
@click.option("--base-thickness", type=length, metavar="LENGTH", help="Glass below the relief. [default: 3mm]")
@click.option("--max-height", type=length, metavar="LENGTH", help="Highest minus lowest point. [default: 2mm]")
@click.option(
    "--smoothness", type=number, help="Weight of the bending energy; 0.01 is a smoother plate. [default: 0.001]"
)
@click.option("--floor", type=number, default=0.1, show_default=True, help="Light that black keeps, share of the mean.")
@click.option(
    "--margin", type=length, metavar="LENGTH", default="0mm", help="Dark border within the window. [default: 0mm]"
)
@click.option(
    "--fit",
    type=click.Choice(["crop", "pad", "stretch"]),
    default="crop",
    show_default=True,
    help="What becomes of a picture of another shape.",
)
@click.option(
    "--transfer",
    type=click.Choice(["linear", "srgb"]),
    help="Tone curve of the picture. [default: srgb of 8 and 16 bits, linear of floats]",
)
@click.option("--mirror", is_flag=True, help="For a screen looked at from the plate's side instead of through it.")
@click.option("--max-iterations", type=count, help="Descent steps per image size, at most. [default: 50]")
@click.option("--max-time", type=seconds, metavar="SECONDS", help="Stop after so many seconds.")
@click.option("--force", is_flag=True, help="Replace an earlier result.")
@bench_option
@device_option
@config_options
@json_option
def design(
    target: str,
    output: str,
    screen_distance: float | None,
    plate_size: float | None,
    base_thickness: float | None,
    max_height: float | None,
    smoothness: float | None,
    floor: float,
    margin: float,
    fit: Any,
    transfer: str | None,
    mirror: bool,
    max_iterations: int | None,
    max_time: float | None,
    force: bool,
    bench: str | None,
    device: str,
    config_source: str | None,
    settings: tuple[str, ...],
    as_json: bool,
) -> int:
    """Find a relief whose caustic is the picture TARGET (.png, .tif, .exr, .npy, .npz or .h5).

    Light is collimated and only moved: the picture gets as much as falls on the plate. Row 0 of the picture is the
    lowest y, so it stands upright on a screen seen from below; see --mirror. Ctrl-C ends the search early; the best
    relief so far is still written.
    """
    from cli.config import load_config
    from cli.output import ResultKind, check_target, result_folder
    from cli.shipped_files import config_files

    console = Console(as_json)
    kind = ResultKind("design", DESIGN_FILES)
    folder = check_target(
        output, force, kind, [target, *config_files(config_source), *([] if bench is None else [bench])]
    )
    overrides = {
        "scene.plate_size_m": None if plate_size is None else [plate_size, plate_size],
        "scene.base_thickness_m": base_thickness,
    }
    usual = DEFAULT_SETTINGS if config_source is None else ()
    config = load_config(config_source, (*usual, *settings), overrides, bench=bench)
    screen_m = -config.scene.screen_position_m[2]
    if screen_distance is None and screen_m > CONTACT_M:
        screen_distance = screen_m
    wishes = {
        "max_height_m": max_height,
        "screen_distance_m": screen_distance,
        "smoothness": smoothness,
        "max_iterations": max_iterations,
        "max_time_s": max_time,
    }

    from warp_caustics.design.designer import Designer
    from warp_caustics.design.target import grey, target_irradiance

    options = design_options(wishes)
    picture = read_picture(target, transfer)
    light = grey(picture.values)
    wanted = target_irradiance(light[:, ::-1] if mirror else light, config.scene, floor=floor, margin_m=margin, fit=fit)
    designer = Designer(config.scene, options, start_device(device))
    with result_folder(folder, force, kind) as temporary:
        with console.progress() as progress:
            result = designer.design(wanted, progress)
        config = designed_config(config, result)
        reading = {"floor": floor, "margin_m": margin, "fit": fit, "transfer": transfer, "mirror": mirror}
        record = design_record(target, result, config, reading, picture)
        write_design(temporary, result, config, record)
    console.warn(*record["warnings"])
    console.line(*summary(output, result))
    console.record(record)
    if result.stop_reason == "interrupted":
        click.echo(f"interrupted; the best relief so far is in {output}", err=True)
        return EXIT_INTERRUPTED
    return 0


DESIGN_FILES = (
    "height.npy",
    "height.tif",
    "surface.stl",
    "caustic.png",
    "caustic.tif",
    "target.tif",
    "design.png",
    "result.json",
    "config.resolved.yaml",
)
"""What the folder of a design holds."""


def design_options(wishes: dict[str, Any]) -> Any:
    """The options of a design; None takes the default.

    Raises:
        InputError: a value out of range, in one line.
    """
    from cli.config import validated
    from warp_caustics.design.options import DesignOptions

    return validated(DesignOptions, {key: value for key, value in wishes.items() if value is not None})


def read_picture(path: str, transfer: str | None) -> "ImageFile":
    """A picture in linear light; integers are taken as sRGB unless told otherwise, since pictures are."""
    from warp_caustics.io.images import read_image

    picture = read_image(path, transfer=transfer)
    if transfer is None and picture.full_scale is not None:
        return read_image(path, transfer="srgb")
    return picture


def designed_config(config: "Config", result: "Design") -> "Config":
    """The configuration with which ``nsfc simulate`` makes the picture of the check again."""
    from cli.config import Config, SimulationConfig

    return Config.model_validate(
        config.model_dump()
        | {"scene": result.scene.model_dump(), "simulation": SimulationConfig(**result.check).model_dump()}
    )


def design_record(
    target: str, result: "Design", config: "Config", reading: dict[str, Any], picture: "ImageFile"
) -> dict[str, Any]:
    """Everything about a design but its arrays."""
    from cli.provenance import file_records, provenance

    return {
        **result.figures,
        "stop_reason": result.stop_reason,
        "iterations": len(result.history),
        "timings_s": result.timings_s,
        "counters": result.counters,
        "settings": reading | result.settings,
        # A camera's linear data must not carry a tone curve; a picture may, and its curve has been taken off.
        "warnings": [*(note for note in picture.warnings if "tone curve" not in note), *result.warnings],
        "inputs": file_records({"target": target}),
        **provenance(config),
        "history": result.history,
    }


def write_design(folder: "Path", result: "Design", config: "Config", record: dict[str, Any]) -> None:
    """Write the files of a design (:data:`DESIGN_FILES`) into a folder."""
    from cli.config import dump_config
    from cli.design_picture import design_figure
    from cli.figures import write_figure
    from cli.output import write_print
    from warp_caustics.io.atomic import write_text
    from warp_caustics.io.images import write_image
    from warp_caustics.io.json_file import write_json

    scene = result.scene
    write_print(folder, result.heights_m, scene)
    write_image(
        folder / "caustic.tif", result.image, wavelengths_m=scene.wavelengths_m, pixel_size_m=scene.pixel_size_m
    )
    write_image(folder / "target.tif", result.target.astype("float32"), pixel_size_m=scene.pixel_size_m)
    write_image(folder / "caustic.png", display_counts(result.image, scene.radiosity_W_m2))
    write_figure(folder / "design.png", design_figure(result))
    write_text(folder / "config.resolved.yaml", dump_config(config))
    write_json(folder / "result.json", record)


def display_counts(image: "FloatArray", radiosity_W_m2: tuple[float, ...]) -> Any:
    """The caustic as a 16-bit sRGB picture in grey, for looking at; white is its 99.9 % quantile. Shape [m, m]."""
    import numpy as np

    light = np.asarray(radiosity_W_m2) > 0
    mean = (image[light] / np.asarray(radiosity_W_m2)[light][:, None, None]).mean(axis=0)
    x = np.clip(mean / max(float(np.percentile(mean, 99.9)), 1e-9), 0.0, 1.0)
    # IEC 61966-2-1, as the reader of pictures takes it.
    coded = np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
    return np.rint(coded * 65535).astype(np.uint16)


def summary(output: str, result: "Design") -> list[str]:
    """A few lines for people."""
    picture, relief, settings = result.figures["picture"], result.figures["relief"], result.settings
    chosen = ", chosen by the height limit" if settings["distance_was_chosen"] else ""
    ssim = "" if picture["ssim"] is None else f", SSIM {picture['ssim']:.3f}"
    ratio = "" if picture["contrast_ratio"] is None else f", {picture['contrast_ratio']:.0%} of its contrast"
    period = "" if relief["finest_period_m"] is None else f", finest wave {relief['finest_period_m'] * 1e3:.2g} mm"
    return [
        f"result     {output}: {', '.join(DESIGN_FILES)}",
        f"search     {len(result.history)} iterations, {sum(result.timings_s.values()):.1f} s, "
        f"stopped by {result.stop_reason.replace('_', ' ')}",
        f"screen     {settings['screen_distance_m']:.4g} m below the plate{chosen}",
        f"picture    {picture['psnr_dB']:.1f} dB from the target{ssim}{ratio}",
        f"light      {picture['light_in_bright']:.1%} in the bright part, "
        f"{picture['target_light_in_bright']:.1%} wanted, {picture['bright_area']:.1%} without a relief",
        f"relief     {relief['height_range_m'] * 1e3:.4g} mm of at most {settings['max_height_m'] * 1e3:.4g} mm, "
        f"slopes up to {relief['max_slope']:.3g}{period}",
    ]
