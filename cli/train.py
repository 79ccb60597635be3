"""``nsfc train``: train a network, or go on training it."""

import os
from collections.abc import Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rich_click as click

from cli.console import Console
from cli.options import config_options, device_option, duration, integer, json_option
from warp_caustics.device import start_device
from warp_caustics.errors import EXIT_INTERRUPTED, EXIT_TERMINATED, InputError, ResourceError

if TYPE_CHECKING:
    from cli.train_progress import Outlook
    from nets.training.config import RunConfig
    from nets.training.progress import TrainingResult

KINDS = ("denoiser", "updater", "direct", "unrolled")
LARGE_ON_CPU = 256
"""Pixels per side from which a training on a CPU takes days."""
EXIT_CODES = {"interrupted": EXIT_INTERRUPTED, "terminated": EXIT_TERMINATED}


@click.command()
@click.argument("kind", type=click.Choice(KINDS))
@click.argument("data", type=click.Path(), required=False)
@click.option("-o", "--output", type=click.Path(), required=True, metavar="RUN", help="Folder of the run.")
@click.option("--fresh", is_flag=True, help="Simulate samples when they are needed instead of reading DATA.")
@click.option("--preset", help="Network: paper, direct, direct-small, direct-large, unrolled, unrolled-small ...")
@click.option("--initial-weights", type=click.Path(), help="Weights file to start from.")
@click.option("--from-shipped", is_flag=True, help="Start from the weights of this kind that come with the software.")
@click.option("--resume", is_flag=True, help="Continue the run in the folder from its last checkpoint.")
@click.option("--force", is_flag=True, help="Delete an earlier run in the folder.")
@click.option(
    "--max-time", type=duration, metavar="TIME", help="Train for so long, counted from the first step, e.g. 8m."
)
@click.option("--max-steps", type=integer, help="Stop this command when the run has so many steps.")
@click.option("--total-time", type=duration, metavar="TIME", help="Length of the whole run, over several commands.")
@click.option("--total-steps", type=integer, help="The same in steps; cosine decay ends there.")
@click.option("--batch-size", type=integer, help="Samples per device and step.")
@click.option("--precision", type=click.Choice(("32", "bf16", "16")), help="Of the network's arithmetic.")
@click.option("--seed", type=integer, help="Of weights, samples and augmentation.")
@click.option("--devices", type=integer, default=1, show_default=True, help="GPUs; each gets samples of its own.")
@device_option
@config_options
@json_option
def train(
    kind: str,
    data: str | None,
    output: str,
    fresh: bool,
    preset: str | None,
    initial_weights: str | None,
    from_shipped: bool,
    resume: bool,
    force: bool,
    max_time: float | None,
    max_steps: int | None,
    total_time: float | None,
    total_steps: int | None,
    batch_size: int | None,
    precision: str | None,
    seed: int | None,
    devices: int,
    device: str,
    config_source: str | None,
    settings: tuple[str, ...],
    as_json: bool,
) -> int:
    """Train a network: denoiser, updater, direct (image to heights) or unrolled.

    Samples come from the data set DATA, or are simulated (--fresh). Without --total-time and --total-steps,
    --max-time or --max-steps of the first command is the length of the run. Ctrl-C ends with a checkpoint.
    """
    _check_usage(data, fresh, resume, force, devices, preset, config_source)
    if from_shipped and (initial_weights is not None or resume):
        other = "--resume" if resume else "--initial-weights"
        raise click.UsageError(f"--from-shipped does not go with {other}; leave one of them out")
    from cli.train_config import new_run, resumed_run

    console = Console(as_json)
    if not resume and total_steps is None and total_time is None:
        total_steps = max_steps
    overrides = {
        "training.batch_size": batch_size,
        "training.precision": precision,
        "training.seed": seed,
        "training.total_steps": total_steps,
        "training.total_time_s": total_time,
        "data": os.path.abspath(data) if data is not None else None,
        "initial_weights": os.path.abspath(initial_weights) if initial_weights is not None else None,
    }
    # The other processes of a run are started by the first, which has checked and made the folder.
    is_first = int(os.environ.get("RANK", os.environ.get("LOCAL_RANK", "0"))) == 0
    folder = Path(os.path.realpath(output))
    if resume:
        config = resumed_run(folder, settings, overrides)
        if config.kind != kind:
            raise InputError(f"run {output!r} trains a {config.kind}; give that instead of {kind!r}")
    else:
        config = new_run(kind, preset, config_source, settings, overrides)  # type: ignore[arg-type]
        if from_shipped:
            from nets.shipped import shipped_start

            config = config.model_copy(update={"initial_weights": shipped_start(config.network)})
    from cli.run_folder import run_folder

    where = _start(device, devices)
    if is_first and not resume:
        _check_inputs(output, config, config_source)
    with run_folder(folder, force=force, resume=resume) if is_first else nullcontext():
        result = _trained(config, folder, console, is_first, where, max_time, max_steps, resume)
    if is_first:
        console.line(*summary(output, result))
        console.record({"output": output, **_record(result), "config": config.model_dump(mode="json")})
    if result.stop_reason in EXIT_CODES:
        if is_first:
            click.echo(f"{result.stop_reason}; continue with nsfc train {kind} -o {output} --resume", err=True)
        return EXIT_CODES[result.stop_reason]
    return 0


def _check_usage(
    data: str | None, fresh: bool, resume: bool, force: bool, devices: int, preset: str | None, config: str | None
) -> None:
    if resume:
        given = {"DATA": data, "--fresh": fresh, "--force": force, "--preset": preset, "--config": config}
        for name, value in given.items():
            if value:
                raise click.UsageError(f"{name} does not go with --resume, which takes it from the run; leave it out")
    elif (data is None) == (not fresh):
        raise click.UsageError("give the folder of a data set or --fresh, and not both")
    if devices < 1:
        raise click.UsageError(f"--devices {devices} is below 1")


def _start(device: str, devices: int) -> tuple[str, int]:
    name = start_device(device)
    if devices > 1:
        import torch

        if ":" in device:
            raise InputError(f"--device {device} is one GPU, --devices {devices} wants more; use --device cuda")
        found = torch.cuda.device_count() if name.startswith("cuda") else devices
        if found < devices:
            raise ResourceError(f"--devices {devices}, but {found} GPUs found; use --devices {max(1, found)}")
    return name, devices


def _check_inputs(output: str, config: "RunConfig", source: str | None) -> None:
    """Refuse files that are missing, or in the folder of the run, before an earlier run is deleted."""
    from cli.output import check_apart
    from cli.shipped_files import config_files
    from warp_caustics.io.atomic import regular_file

    named = (config.initial_weights, config.training.denoiser_weights, config.training.unrolling.direct_weights)
    weights = [path for path in named if path]
    data = [] if config.data is None else [config.data]
    check_apart(output, [*weights, *data, *config_files(source)])
    for path in weights:
        regular_file(path)


def _trained(
    config: "RunConfig",
    folder: Path,
    console: Console,
    is_first: bool,
    where: tuple[str, int],
    max_time: float | None,
    max_steps: int | None,
    resume: bool,
) -> "TrainingResult":
    from cli.config import dump_config
    from cli.train_config import RESOLVED
    from cli.train_progress import training_observer
    from nets.training.devices import launched
    from nets.training.fit import fit
    from nets.training.limits import Limits
    from warp_caustics.io.atomic import write_text

    if is_first:
        write_text(folder / RESOLVED, dump_config(config))
    fabric = launched(*where)
    limits = Limits(max_steps, max_time_s=max_time)
    with training_observer(console, is_first, _outlook(config, max_steps, where[0])) as observer:
        return fit(config, folder, fabric, observer, limits, resume=resume)


def _outlook(config: "RunConfig", max_steps: int | None, device: str) -> "Outlook":
    """How long the run is, and on a CPU how long such runs usually are."""
    from cli.train_progress import Outlook
    from nets.shipped import shipped_steps

    training = config.training
    ends = [steps for steps in (training.total_steps, max_steps) if steps is not None]
    is_large = config.scene.image_pixels >= LARGE_ON_CPU
    return Outlook(
        training.steps_per_epoch if config.data is None else None,
        min(ends) if ends else None,
        shipped_steps(config.kind) if device == "cpu" and is_large else None,
    )


def summary(output: str, result: "TrainingResult") -> list[str]:
    """A few lines for people."""
    lines = [
        f"run        {output}, {result.step} steps, {result.elapsed_s:.1f} s, "
        f"stopped by {result.stop_reason.replace('_', ' ')}"
    ]
    if result.best is not None:
        lines.append(f"best       {result.objective.removeprefix('val_').replace('_', ' ')} {result.best:.4g}")
    if result.weights is not None:
        lines.append(f"weights    {result.weights}")
    return lines


def _record(result: "TrainingResult") -> Mapping[str, Any]:
    from dataclasses import asdict

    return asdict(result)
