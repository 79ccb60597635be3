"""``nsfc inspect``: a printed plate against its design, from one caustic image."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import rich_click as click

from cli.capture_options import capture_options
from cli.console import Console
from cli.garbage import postponed
from cli.options import bench_option, config_options, device_option, json_option, number
from cli.options import plate_length as length

if TYPE_CHECKING:
    from warp_caustics.prints.line import Section

SECTIONS = ("cosine", "quarter")
"""Of ``warp_caustics.prints.line``, which takes too long to load for a line of help."""


@click.command()
@click.argument("images", metavar="IMAGE...", nargs=-1, required=True, type=click.Path())
@click.option(
    "--nominal",
    metavar="DESIGN",
    type=click.Path(),
    required=True,
    help="Height map in metres, solid in millimetres (.stl, .ply, .obj), printed lines or design (.csv, .yaml).",
)
@click.option(
    "--find-lines",
    is_flag=True,
    help="DESIGN is a height map or solid of printed lines: find them first. A minute for a dozen lines.",
)
@click.option(
    "--section",
    type=click.Choice(SECTIONS),
    default="cosine",
    show_default=True,
    help="Cross section of printed lines: a raised cosine, or a quarter of a cosine, which is steep at its edges.",
)
@click.option(
    "--tolerance",
    metavar="LENGTH",
    type=length,
    required=True,
    help="Largest distance from the nominal surface, e.g. 50um, 0.05mm or 5e-5 (metres).",
)
@click.option(
    "-o", "--output", type=click.Path(), required=True, help="Folder for the result, or for those of many plates."
)
@click.option(
    "--max-height",
    metavar="LENGTH",
    type=length,
    help="Highest DESIGN that is believed, e.g. 12mm. [default: three times the plate's thickness]",
)
@click.option("--mask", type=click.Path(), help="Image or height map of the plate; only where it is not 0 is judged.")
@click.option("--margin", metavar="LENGTH", type=length, default="0", help="Border that is not judged, e.g. 1mm.")
@click.option(
    "--density", metavar="KG_M3", type=number, help="Of the glass [kg/m^3]. [default: that of the scene's glass]"
)
@click.option(
    "--placed",
    is_flag=True,
    help="The picture lies where DESIGN says: judge shift, turn and size of the whole, do not find them first.",
)
@click.option(
    "--watch",
    metavar="SECONDS",
    type=number,
    help="IMAGE is a folder; look for new images so often, until Ctrl-C.",
)
@click.option("--force", is_flag=True, help="Replace earlier results; of many plates, inspect each again.")
@bench_option
@capture_options
@device_option
@config_options
@json_option
@postponed()
def inspect(
    images: tuple[str, ...],
    nominal: str,
    find_lines: bool,
    section: "Section",
    tolerance: float,
    output: str,
    max_height: float | None,
    mask: str | None,
    margin: float,
    density: float | None,
    placed: bool,
    watch: float | None,
    force: bool,
    bench: str | None,
    capture: Mapping[str, Any],
    device: str,
    config_source: str | None,
    settings: tuple[str, ...],
    as_json: bool,
) -> int:
    """Compare the printed plate behind IMAGE with its DESIGN: deviation, regions, fibres, volume, verdict.

    Of several images, a folder or a pattern, each plate's result goes to OUTPUT/name-of-the-image, and
    OUTPUT/plates.csv has a row for each. The exit code is 0 if every plate is shown to be within tolerance, 7 if not.
    """
    from cli.config import load_config
    from cli.inputs import image_list
    from cli.inspection.job import InspectionJob
    from cli.inspection.series import run_series, run_watch
    from cli.output import check_target
    from cli.shipped_files import config_files
    from warp_caustics.capture.settings import capture_settings
    from warp_caustics.errors import InputError
    from warp_caustics.inspection.nominal import judged_part, read_nominal, with_lines

    if not tolerance > 0:
        raise click.BadParameter("0 would fail every plate; give a length such as 50um", param_hint="--tolerance")
    if density is not None and not density > 0:
        raise click.BadParameter(f"{density:g} is not above 0; fused silica has 2200", param_hint="--density")
    if watch is not None and not (watch > 0 and len(images) == 1):
        raise click.BadParameter("give seconds above 0 and one folder of images", param_hint="--watch")
    console = Console(as_json)
    found = images[0] if watch is not None else image_list(images)
    config = load_config(config_source, settings, {}, bench=bench)
    capture_settings(capture)  # what is wrong with it is wrong for every image
    design = read_nominal(nominal, config.scene, section, highest_m=max_height)
    if find_lines:
        design = with_lines(design, nominal, config.scene)
    files = {"nominal": nominal, "mask": mask, "bench": bench}
    job = InspectionJob(
        config=config,
        nominal=design,
        judged=judged_part(mask, margin, config.scene),
        tolerance_m=tolerance,
        margin_m=margin,
        density_kg_m3=density,
        is_placed=placed,
        files={role: path for role, path in files.items() if path is not None},
        capture=capture,
        device=device,
        force=force,
        console=console,
    )
    if watch is not None:
        from pathlib import Path

        if not Path(images[0]).is_dir():
            raise InputError(f"{images[0]!r} is no folder; --watch looks into one")
        return run_watch(job, images[0], output, watch)
    if not isinstance(found, str):
        return run_series(job, found, output)
    outcome = job.run(
        found, check_target(output, force, job.kind, [*job.reads(found), *config_files(config_source)]), output
    )
    console.record(outcome.record)
    return outcome.exit_code
