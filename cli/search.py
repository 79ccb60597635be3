"""``nsfc search``: find good numbers of Tab. 2 with Optuna, or go on finding them."""

import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rich_click as click

from cli.console import Console
from cli.options import config_options, device_option, duration, integer, json_option
from warp_caustics.device import start_device
from warp_caustics.errors import EXIT_INTERRUPTED, EXIT_TERMINATED, CausticsError, InputError, ResourceError

if TYPE_CHECKING:
    import optuna

    from nets.search.config import SearchConfig
    from nets.search.study import Address

KINDS = ("denoiser", "updater")
RESOLVED = "search.yaml"
SEARCHED = ("network.network", "training.learning_rate", "training.lambda_tv", "training.total_steps")
"""Keys that trials set, so nobody else may."""


@click.command()
@click.argument("kind", type=click.Choice(KINDS))
@click.argument("data", type=click.Path(), required=False)
@click.option("-o", "--output", type=click.Path(), required=True, metavar="DIR", help="Folder of the search.")
@click.option("--fresh", is_flag=True, help="Simulate samples instead of reading DATA.")
@click.option("--n-trials", type=integer, required=True, help="Finished trials of the study in the end.")
@click.option("--pool", type=integer, metavar="N", help="Make N samples once per worker, for all of its trials.")
@click.option("--max-epochs", type=integer, default=15, show_default=True, help="Epochs of a trial, 5 or more.")
@click.option("--steps-per-epoch", type=integer, help="Optimiser steps of an epoch; with --fresh or --pool.")
@click.option("--trial-time", type=duration, metavar="TIME", help="Judge a trial by its best epoch until then.")
@click.option("--max-time", type=duration, metavar="TIME", help="Stop this command after so long, e.g. 8m.")
@click.option("--sampler", type=click.Choice(("tpe", "gp")), default="tpe", show_default=True, help="What proposes.")
@click.option("--paper-first", is_flag=True, help="Let a new study begin with Tab. 2's best member.")
@click.option("--storage", metavar="URL", help="Database of several machines. [default: DIR/study.db]")
@click.option("--study", "name", help="Name in the database. [default: nsfc-KIND]")
@click.option("--workers", type=integer, default=1, show_default=True, help="Processes on this machine.")
@click.option("--devices", type=integer, help="GPUs that the workers share. [default: all, but not above --workers]")
@click.option("--batch-size", type=integer, help="Samples per step.")
@click.option("--precision", type=click.Choice(("32", "bf16", "16")), help="Of the networks' arithmetic.")
@click.option("--seed", type=integer, help="Of weights, samples and sampler.")
@device_option
@config_options
@json_option
def search(
    kind: str,
    data: str | None,
    output: str,
    fresh: bool,
    n_trials: int,
    pool: int | None,
    max_epochs: int,
    steps_per_epoch: int | None,
    trial_time: float | None,
    max_time: float | None,
    sampler: str,
    paper_first: bool,
    storage: str | None,
    name: str | None,
    workers: int,
    devices: int | None,
    batch_size: int | None,
    precision: str | None,
    seed: int | None,
    device: str,
    config_source: str | None,
    settings: tuple[str, ...],
    as_json: bool,
) -> int:
    """Search for a good denoiser or updater: network and learning rate within the ranges of Tab. 2.

    Given again, the same command goes on where it stopped. Started on several machines with one --storage, it shares
    the work. DIR holds best.yaml for nsfc train --config, trials.csv and report.html.
    """
    start = time.monotonic()
    _check_usage(data, fresh, n_trials, pool, steps_per_epoch, workers, devices)
    from cli.config import validated
    from cli.spelled import spelled_in
    from cli.train_config import new_run
    from nets.search.config import SearchConfig

    overrides = {
        "training.batch_size": batch_size,
        "training.precision": precision,
        "training.seed": seed,
        "training.steps_per_epoch": steps_per_epoch,
        "training.fixed_samples": pool,
        "data": os.path.abspath(data) if data is not None else None,
    }
    _check_settings(settings)
    run = new_run(kind, None, config_source, settings, overrides)  # type: ignore[arg-type]
    limits = {"max_epochs": max_epochs, "trial_time_s": trial_time}
    wanted = validated(SearchConfig, {"run": run, "sampler": sampler, **limits}, spelled_in([], limits))
    chosen = _devices(start_device(device), device, workers, devices)
    folder = _folder(output)
    from nets.search.study import address

    where = address(storage, folder, name or f"nsfc-{kind}")
    deadline = start + max_time if max_time is not None else None
    console = Console(as_json)
    code, study = _searched(wanted, where, folder, n_trials, deadline, chosen, paper_first, console)
    record = _record(output, study, wanted, time.monotonic() - start)
    console.line(*_summary(record))
    console.record(record)
    return code


def _check_usage(
    data: str | None,
    fresh: bool,
    n_trials: int,
    pool: int | None,
    steps_per_epoch: int | None,
    workers: int,
    devices: int | None,
) -> None:
    if (data is None) == (not fresh):
        raise click.UsageError("give the folder of a data set or --fresh, and not both")
    if steps_per_epoch is not None and not fresh and not pool:
        raise click.UsageError("a data set has epochs of its own; leave --steps-per-epoch out, or give --pool")
    for option, value in (("--n-trials", n_trials), ("--workers", workers), ("--devices", devices)):
        if value is not None and value < 1:
            raise click.UsageError(f"{option} {value} is below 1")


def _check_settings(settings: Sequence[str]) -> None:
    for setting in settings:
        key = setting.partition("=")[0].strip()
        if any(key == name or key.startswith(f"{name}.") for name in SEARCHED):
            raise InputError(f"--set {key} is what the search varies; leave it out (--max-epochs ends trials)")


def _devices(found: str, asked: str, workers: int, devices: int | None) -> list[str]:
    """The device of each worker."""
    if not found.startswith("cuda") or ":" in asked:
        if devices is not None and devices > 1:
            raise InputError(f"--devices {devices}, but --device {asked} is one; use --device cuda")
        return [found] * workers
    import torch

    there = torch.cuda.device_count()
    if devices is not None and devices > there:
        raise ResourceError(f"--devices {devices}, but {there} GPUs found; use --devices {max(1, there)}")
    used = devices or min(workers, there)
    return [f"cuda:{worker % used}" for worker in range(workers)]


def _folder(output: str) -> Path:
    """The folder of the search, made if it is missing.

    Raises:
        InputError: it holds something else.
    """
    from cli.claims import claim_folder
    from nets.search.report import FILES
    from nets.search.study import FILE

    database = (FILE, *(f"{FILE}-{part}" for part in ("journal", "wal", "shm")))  # SQLite's own
    names = (*FILES, RESOLVED, *database, ".outputs.lock", ".claims.lock")
    return claim_folder(output, "search", names, _is_unmarked, "name a new folder")


def _is_unmarked(folder: Path) -> bool:
    """Whether a search of a version that left no marker is in a folder."""
    from cli.marker import is_regular
    from warp_caustics.io.yaml_file import read_yaml

    if not is_regular(folder / RESOLVED):
        return False
    try:
        return {"run", "max_epochs", "sampler"} <= read_yaml(folder / RESOLVED).keys()
    except CausticsError:
        return False


def _searched(
    wanted: "SearchConfig",
    where: "Address",
    folder: Path,
    n_trials: int,
    deadline: float | None,
    devices: list[str],
    paper_first: bool,
    console: Console,
) -> tuple[int, "optuna.Study"]:
    """Exit code, and the study as it is then."""
    from cli.config import dump_config
    from cli.search_progress import search_progress
    from nets.search.processes import Plan, run_here, run_workers
    from nets.search.report import write_outputs
    from nets.search.signals import StoppedError
    from nets.search.study import open_study, queue_best_of_paper
    from nets.search.worker import Goal
    from warp_caustics.io.atomic import write_text

    study = open_study(where, wanted)  # before anything is written: it may be of another search
    write_text(folder / RESOLVED, dump_config(wanted))
    if paper_first:
        queue_best_of_paper(study, wanted)
    plan = Plan(where, wanted, Goal(n_trials, deadline), folder, wanted.run.training.seed)
    code = 0
    try:
        with search_progress(console, study, n_trials) as show:
            if len(devices) == 1:
                run_here(plan, devices[0], show)
            else:
                run_workers(plan, devices, show)
    except KeyboardInterrupt as error:
        stopped = error.reason if isinstance(error, StoppedError) else "interrupted"
        code = EXIT_TERMINATED if stopped == "terminated" else EXIT_INTERRUPTED
        click.echo(f"{stopped}; the same command goes on", err=True)
    finally:
        write_outputs(folder, study, wanted, is_last=True)
    return code, study


def _record(output: str, study: "optuna.Study", wanted: "SearchConfig", elapsed_s: float) -> dict[str, Any]:
    from dataclasses import asdict

    from nets.search.report import best_trial
    from nets.search.study import count

    best = best_trial(study.get_trials(deepcopy=False))
    counts = count(study)
    return {
        "output": output,
        "study": study.study_name,
        "trials": {"finished": counts.finished, **asdict(counts)},
        "best": None if best is None else {"number": best.number, "loss": best.value, "values": best.params},
        "elapsed_s": elapsed_s,
        "config": wanted.model_dump(mode="json"),
    }


def _summary(record: dict[str, Any]) -> list[str]:
    trials, best = record["trials"], record["best"]
    lines = [
        f"search     {record['output']}, {trials['finished']} trials: {trials['complete']} complete, "
        f"{trials['pruned']} pruned, {trials['failed']} failed, {record['elapsed_s']:.1f} s"
    ]
    if best is None:
        return [*lines, "best       none, no trial is complete"]
    values = ", ".join(f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in best["values"].items())
    return [
        *lines,
        f"best       trial {best['number']}, loss {best['loss']:.4g}: {values}",
        f"config     {os.path.join(record['output'], 'best.yaml')}",
    ]
