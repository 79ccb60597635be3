"""``nsfc reconstruct``: from one caustic image to the printed heights."""

from collections.abc import Mapping
from typing import Any

import rich_click as click

from cli.capture_options import capture_options
from cli.console import Console
from cli.garbage import postponed
from cli.options import bench_option, config_options, count, device_option, integer, json_option, seconds
from warp_caustics.errors import EXIT_INTERRUPTED

SET_UPS = ("known", "estimate")
"""Of ``nets.reconstruct.direct_options``, which takes too long to load for a line of help."""

MOST_SAMPLES = 5
"""Of ``nets.reconstruct.posterior_samples``; likewise."""

TRANSPORT = "transport"
"""Value of --initial that is no file; a file of that name is ./transport."""


@click.command()
@click.argument("images", metavar="IMAGE...", nargs=-1, required=True, type=click.Path())
@click.option(
    "-o", "--output", type=click.Path(), required=True, help="Folder for the result; made complete or not at all."
)
@click.option(
    "--method", help="auto, direct, fibres, nsfc, nsfc-unrolled, refine, transport, hcccd or sfc. [default: auto]"
)
@capture_options
@click.option(
    "--initial",
    metavar="FILE|transport",
    help="Heights or printed lines to start from, or transport: what that finds. [default: the method's choice]",
)
@click.option("--reference", type=click.Path(), help="True heights or printed lines; errors are told against them.")
@click.option("--max-iterations", type=count, help="Iterations per stage, at most.")
@click.option("--max-time", type=seconds, metavar="SECONDS", help="Stop after so many seconds.")
@click.option(
    "--set-up",
    type=click.Choice(SET_UPS),
    help="known: the bench is as it is told; estimate: look for its numbers beside the heights (direct, fibres, auto). "
    "[default: estimate; of fibres on a CPU known]",
)
@click.option(
    "--prior",
    "priors",
    multiple=True,
    metavar="NAME=WIDTH",
    help="Standard deviation of a number that is told, in SI units or as gap_m=5um; 0 is exact. Of the uncertainty, "
    "and of --set-up estimate (direct, fibres, auto).",
)
@click.option(
    "--samples",
    type=click.IntRange(0, MOST_SAMPLES),
    metavar="N",
    help="Write N reliefs besides that explain the image about as well and differ where it leaves the heights open, up "
    "to 5 (direct, fibres, auto). Takes eight more refinements.",
)
@click.option("--seed", type=integer, help="For methods that draw random numbers, as nsfc does.")
@click.option("--force", is_flag=True, help="Replace an earlier result.")
@bench_option
@device_option
@config_options
@json_option
@postponed()
def reconstruct(
    images: tuple[str, ...],
    output: str,
    method: str | None,
    capture: Mapping[str, Any],
    initial: str | None,
    reference: str | None,
    max_iterations: int | None,
    max_time: float | None,
    force: bool,
    bench: str | None,
    set_up: str | None,
    priors: tuple[str, ...],
    samples: int | None,
    seed: int | None,
    device: str,
    config_source: str | None,
    settings: tuple[str, ...],
    as_json: bool,
) -> int:
    """Recover the height field behind IMAGE, one caustic (.tif, .png, .exr, .npy, .npz or .h5).

    Of several images, a folder or a pattern, each result goes to OUTPUT/name-of-the-image as soon as it is done.
    Ctrl-C ends the iteration early; the best result so far is still written.
    """
    from cli.batch import run_batch
    from cli.bench_told import told_options
    from cli.config import load_config
    from cli.inputs import image_list
    from cli.job import Job
    from cli.output import check_target
    from cli.shipped_files import config_files
    from warp_caustics.capture.settings import capture_settings

    console = Console(as_json)
    found = image_list(images)
    config = load_config(
        config_source,
        settings,
        {
            "simulation.seed": seed,
            "reconstruction.method": method,
            "reconstruction.options.max_iterations": max_iterations,
            "reconstruction.options.max_time_s": max_time,
        },
        bench=bench,
    )
    config = told_options(config, bench, set_up, priors, samples)
    start = None if initial == TRANSPORT else initial
    files = {"initial": start, "reference": reference, "bench": bench}
    capture_settings(capture)  # what is wrong with it is wrong for every image
    job = Job(
        config=config,
        files={kind: path for kind, path in files.items() if path is not None},
        capture=capture,
        from_transport=initial == TRANSPORT,
        device=device,
        force=force,
        console=console,
    )
    if not isinstance(found, str):
        return run_batch(job, found, output)
    target = check_target(output, force, job.kind, [*job.reads(found), *config_files(config_source)])
    outcome = job.run(found, target, output)
    console.record(outcome.record)
    if outcome.is_interrupted:
        click.echo(f"interrupted; the best result so far is in {output}", err=True)
        return EXIT_INTERRUPTED
    return 0
