"""``nsfc compare``: every method on the same images, scored against the truth."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rich_click as click

from cli.cells import CellProgress
from cli.console import Console
from cli.options import bench_option, config_options, device_option, integer, jobs_option, json_option, number
from cli.parts_progress import parts_progress
from warp_caustics.device import start_device
from warp_caustics.errors import EXIT_INTERRUPTED, InputError

if TYPE_CHECKING:
    from data_gen.dataset_config import PhotonConfig
    from nets.evaluation.fields import Source
    from nets.evaluation.method_spec import MethodSpec
    from warp_caustics.scene import Scene

OUTPUTS = ("cells", "images", "table.csv", "table.json", "summary.csv", "index.html")
"""All that a folder of comparisons holds."""


@click.command()
@click.argument("fields", type=click.Path(), nargs=-1, metavar="[HEIGHTS|HEIGHTS:IMAGE]...")
@click.option("--testset", is_flag=True, help="Compare on the ten test fields.")
@click.option("--fields", "count", type=integer, metavar="N", help="With --testset: the first N fields only.")
@click.option(
    "--methods",
    multiple=True,
    required=True,
    metavar="A,B,...",
    help="flat, refine, sfc, transport, hcccd, direct, nsfc, ...; sfc:mask=oracle sets, transport+refine chains.",
)
@click.option("-o", "--output", type=click.Path(), required=True, help="Folder; one of an earlier run is continued.")
@click.option(
    "--iterations",
    default="1,5,10,converged",
    show_default=True,
    metavar="N,...,converged",
    help="Where methods that iterate are stopped and looked at.",
)
@click.option("--noise", type=number, default=0.01, show_default=True, help="Noise of simulated images, of flat light.")
@click.option(
    "--n-photons",
    type=integer,
    help="Light paths of simulated images, per wavelength. [default: data.clean.n_photons, or 16000000]",
)
@jobs_option
@click.option("--force", is_flag=True, help="Compute all cells anew.")
@bench_option
@device_option
@config_options
@json_option
def compare(
    fields: tuple[str, ...],
    testset: bool,
    count: int | None,
    methods: tuple[str, ...],
    output: str,
    iterations: str,
    noise: float,
    n_photons: int | None,
    jobs: int,
    force: bool,
    bench: str | None,
    device: str,
    config_source: str | None,
    settings: tuple[str, ...],
    as_json: bool,
) -> int:
    """Compare methods on height maps FIELDS, and show tables and pictures in index.html.

    HEIGHTS alone is simulated; HEIGHTS:IMAGE has an image already. The same command continues after any
    interruption; what is finished is not computed again.
    """
    from cli.config import load_config
    from cli.output import checked_folder
    from nets.evaluation.method_spec import parse_budgets, parse_methods
    from nets.evaluation.processes import gpus_for
    from warp_caustics.io.journal import journal_path, only_writer

    specs, budgets = parse_methods(methods), parse_budgets(iterations)
    config = load_config(config_source, settings, bench=bench)
    photons = _photons(n_photons or config.data.clean.n_photons)
    _check_noise(noise)
    console = Console(as_json)
    gpus = gpus_for(device) if jobs > 1 else []
    device = start_device(device)
    from nets.evaluation.run import check_methods

    sources = _sources(fields, testset, count, config.scene, device)
    console.warn(*check_methods(specs, config.scene, device))
    path, _ = checked_folder(output, lambda name: True)
    with only_writer(journal_path(path), path):
        job = _Comparison(sources, list(specs), budgets, config.scene, photons, noise, device, jobs, gpus, force)
        return _compared(job, output, console)


@dataclass(frozen=True)
class _Comparison:
    """What is compared, and how."""

    sources: "list[Source]"
    specs: "Sequence[MethodSpec]"
    budgets: Sequence[str]
    scene: "Scene"
    photons: "PhotonConfig"
    noise: float
    device: str
    jobs: int
    gpus: Sequence[str]
    force: bool


def _compared(job: _Comparison, output: str, console: Console) -> int:
    """Fill the folder, which nobody else writes meanwhile; returns the exit code."""
    from cli.claims import claim_folder
    from nets.evaluation.fields import prepare

    folder = claim_folder(output, "comparison", OUTPUTS, _is_unmarked, "name a new folder, or an earlier one")
    for part in (folder / "cells", folder / "images"):
        part.mkdir(exist_ok=True)
    with parts_progress(console, "images") as told:
        prepared = prepare(job.sources, job.scene, job.photons, job.noise, folder / "images", job.device, told)
    for field in prepared:
        console.warn(*(f"{field.name}: {warning}" for warning in field.warnings))

    from nets.evaluation.cells import CellStore
    from nets.evaluation.schedule import Setup, run_cells

    store = CellStore(folder / "cells")
    setup = Setup({field.name: field for field in prepared}, job.scene, job.photons, job.device, store)
    cells = setup.cells(job.specs, job.budgets)
    if job.jobs > 1:
        console.warn(f"{job.jobs} jobs share this machine, so times are longer than those of one")
    missing = {cell.key: cell for cell in cells if job.force or store.record(cell.key) is None}
    progress = CellProgress(console, list(missing.values()))
    try:
        records = run_cells(setup, cells, jobs=job.jobs, gpus=job.gpus, force=job.force, report=progress)
    except KeyboardInterrupt:
        click.echo(
            f"interrupted; {progress.done} cells were computed and are kept, the same command continues", err=True
        )
        return EXIT_INTERRUPTED

    from cli.cells import failure_reasons, worst_code
    from cli.comparison.about import about_comparison
    from cli.comparison.page import write_page
    from nets.evaluation.table import summary, table_rows, write_tables

    rows = table_rows(records, setup.fields)
    about = about_comparison(setup, job.specs, job.budgets, job.noise)
    write_tables(folder, rows, about)
    write_page(folder / "index.html", setup, records, rows, about)

    console.line(*map(_line, summary(rows)))
    failed = [record for record in records if record["status"] == "failed"]
    console.line(
        f"result     {output}: {len(records)} cells, {progress.done} computed now; see {Path(output) / 'index.html'}"
    )
    console.record(
        {"output": output, "cells": len(records), "computed": progress.done, "failed": len(failed), "rows": rows}
    )
    if failed:
        console.warn(f"{len(failed)} of {len(records)} cells failed: {failure_reasons(failed)}")
    return worst_code(failed) if len(failed) == len(records) else 0


def _photons(count: int | None) -> Any:
    from data_gen.dataset_config import PhotonConfig
    from data_gen.testset import TEST_PHOTONS

    wished = {} if count is None else {"n_photons": count}
    return PhotonConfig(**{**TEST_PHOTONS.model_dump(), **wished})


def _check_noise(noise: float) -> None:
    if not 0 <= noise <= 1:
        raise InputError(
            f"noise {noise:g} is not between 0 and 1, parts of the light through a flat plate; 0.01 is 1 %"
        )


def _is_unmarked(folder: Path) -> bool:
    """Whether a comparison of a version that left no marker is in a folder."""
    from nets.evaluation.cells import CellStore

    store = CellStore(folder / "cells")
    return any(store.record(path.stem) is not None for path in (folder / "cells").glob("*.json") if path.is_file())


def _sources(fields: tuple[str, ...], testset: bool, count: int | None, scene: "Scene", device: str) -> "list[Source]":
    from nets.evaluation.fields import file_sources, testset_sources

    if testset == bool(fields):
        raise InputError("give either height maps or --testset")
    if count is not None and not testset:
        raise InputError("--fields counts test fields; add --testset, or leave it out")
    return testset_sources(scene, device, count) if testset else file_sources(fields, scene)


def _line(row: Mapping[str, Any]) -> str:
    name = f"{row['method']}, {row['budget']}"
    if row["rmse_um_median"] is None:
        return f"{name:<40}  failed"
    return (
        f"{name:<40}  RMSE median {row['rmse_um_median']:8.4g} um, mean {row['rmse_um_mean']:8.4g} um, "
        f"{row['time_s_median']:6.3g} s, {row['done']} of {row['fields']} fields"
    )
