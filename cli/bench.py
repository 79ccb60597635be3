"""``nsfc bench``: methods on benches, cameras and prints that are not as they are told."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rich_click as click

from cli.cells import CellProgress, failure_reasons, worst_code
from cli.console import Console
from cli.options import device_option, integer, jobs_option, json_option
from warp_caustics.device import start_device
from warp_caustics.errors import EXIT_INTERRUPTED, InputError

if TYPE_CHECKING:
    from data_gen.suites.case import Case
    from nets.evaluation.bench.runs import Run

OUTPUTS = ("cells", "images", "table.json", "index.html")
"""All that a folder of a run or of scores holds."""
SUITE_NAMES = ("ideal", "one-thing", "lab", "prints")

suite_option = click.option("--suite", type=click.Choice(SUITE_NAMES), required=True, help="Which cases.")
plates_option = click.option(
    "--fields", "plates", type=integer, metavar="N", help="The first N plates of each row only."
)
rows_option = click.option("--rows", metavar="A,B,...", default="", help="Rows of the suite only; see nsfc bench list.")
seed_option = click.option(
    "--seed",
    type=integer,
    metavar="N",
    help="Other plates under the same differences: for what is tuned, which the suite's own then judge.",
)
photons_option = click.option(
    "--n-photons", type=integer, help="Light paths per wavelength of the images, in place of the suite's; fewer to try."
)


@click.group()
def bench() -> None:
    """The test bench: plates, benches and cameras that no method was trained on, with the truth and the scores."""


@bench.command(name="list")
@click.option("--suite", type=click.Choice(SUITE_NAMES), help="Rows of this suite.")
@json_option
def list_suites(suite: str | None, as_json: bool) -> None:
    """List the suites, or the rows of one."""
    from data_gen.suites.suites import SUITES, suite_cases

    console = Console(as_json)
    if suite is None:
        found = {name: {"about": each.about, "plates": each.plates} for name, each in SUITES.items()}
        counts = {name: len(suite_cases(name)) for name in SUITES}
        console.line(*(f"{name:<10} {counts[name]:>4} cases  {each.about}" for name, each in SUITES.items()))
        console.record({name: {**record, "cases": counts[name]} for name, record in found.items()})
        return
    cases = suite_cases(suite)
    titles = {case.row: case.title for case in cases}
    console.line(*(f"{row:<24} {title}" for row, title in titles.items()))
    console.record({"suite": suite, "rows": titles, "cases": [case.name for case in cases]})


@bench.command()
@suite_option
@click.option(
    "--methods", multiple=True, required=True, metavar="A,B,...", help="As of nsfc compare: flat, direct, auto, ..."
)
@click.option("-o", "--output", type=click.Path(), required=True, help="Folder; one of an earlier run is continued.")
@plates_option
@rows_option
@seed_option
@photons_option
@jobs_option
@click.option("--force", is_flag=True, help="Compute all cells anew.")
@device_option
@json_option
def run(
    suite: str,
    methods: tuple[str, ...],
    output: str,
    plates: int | None,
    rows: str,
    seed: int | None,
    n_photons: int | None,
    jobs: int,
    force: bool,
    device: str,
    as_json: bool,
) -> int:
    """Run methods on the cases of a suite, and show tables and pictures in index.html.

    The same command continues after any interruption; what is finished is not computed again.
    """
    from cli.output import checked_folder
    from nets.evaluation.method_spec import parse_methods
    from nets.evaluation.processes import check_jobs, gpus_for
    from warp_caustics.io.journal import journal_path, only_writer

    specs, cases = parse_methods(methods), _cases(suite, plates, rows, seed)
    _check_photons(n_photons)
    check_jobs(jobs)
    gpus = gpus_for(device) if jobs > 1 else []
    console, device = Console(as_json), start_device(device)
    from nets.evaluation.bench.runs import Run
    from nets.evaluation.run import check_methods

    console.warn(*check_methods(specs, cases[0].told, device))
    path, _ = checked_folder(output, lambda name: True)
    with only_writer(journal_path(path), path):
        run = Run(list(specs), _claimed(output), device, n_photons, force, jobs, gpus)
        return _run(cases, run, output, console, seed)


def _run(cases: "Sequence[Case]", run: "Run", output: str, console: Console, seed: int | None) -> int:
    """Fill the folder, which nobody else writes meanwhile; returns the exit code."""
    from nets.evaluation.bench.runs import run_suite

    progress, folder = CellProgress(console), run.folder
    if run.jobs > 1:
        console.warn(f"{run.jobs} jobs share this machine, so times are longer than those of one")
    try:
        records = run_suite(cases, run, report=progress, warn=console.warn)
    except KeyboardInterrupt:
        click.echo(
            f"interrupted; {progress.done} cells were computed and are kept, the same command continues", err=True
        )
        return EXIT_INTERRUPTED
    from cli.bench_report.about import about_run
    from cli.bench_report.pictures import RunPictures

    about = about_run(cases, run, seed)
    pictures = RunPictures(cases, records, folder, run.device, run.n_photons)
    rows = _told(folder, cases, records, about, console, pictures)
    failed = [record for record in records if record["status"] == "failed"]
    console.line(
        f"result     {output}: {len(records)} cells, {progress.done} computed now; see {folder / 'index.html'}"
    )
    console.record(
        {"output": output, "cells": len(records), "computed": progress.done, "failed": len(failed), "rows": rows}
    )
    if failed:
        console.warn(f"{len(failed)} of {len(records)} cells failed: {failure_reasons(failed)}")
    return worst_code(failed) if len(failed) == len(records) else 0


@bench.command()
@click.argument("folder", type=click.Path())
@suite_option
@click.option(
    "-o", "--output", type=click.Path(), help="Folder for table.json and index.html; none are written without."
)
@click.option("--name", default="given", show_default=True, help="Of what made the heights, in the tables.")
@plates_option
@rows_option
@json_option
def score(folder: str, suite: str, output: str | None, name: str, plates: int | None, rows: str, as_json: bool) -> None:
    """Score heights in FOLDER that another program made: CASE.npy or CASE.tif, heights in metres.

    CASE_uncertainty.npy beside it, a standard uncertainty, is scored too. Results of nsfc reconstruct in FOLDER/CASE
    are found as well.
    """
    from nets.evaluation.bench.scoring import score_folder

    console, cases = Console(as_json), _cases(suite, plates, rows)
    records, lines = score_folder(Path(folder), cases, name)
    console.warn(*lines)
    from cli.bench_report.about import about_scores

    about = about_scores(cases, name)
    if output is None:
        table = _lines(records, console)
    else:
        table = _told(_claimed(output), cases, records, about, console, None)
        console.line(f"result     {output}")
    console.record({"folder": folder, "suite": suite, "rows": table})


@bench.command()
@click.argument("directory", type=click.Path())
@suite_option
@plates_option
@rows_option
@photons_option
@device_option
@json_option
def export(
    directory: str, suite: str, plates: int | None, rows: str, n_photons: int | None, device: str, as_json: bool
) -> int:
    """Write a suite to DIRECTORY: 16-bit captures with dark and flat frames, scenes, truth, a card and checksums.

    The same command continues an unfinished one.
    """
    from cli.claims import claim_folder
    from cli.output import checked_folder
    from warp_caustics.io.journal import journal_path, only_writer

    cases = _cases(suite, plates, rows)
    _check_photons(n_photons)
    console, device = Console(as_json), start_device(device)
    from data_gen.suites.export import NAMES, export_suite
    from data_gen.suites.light import Light
    from nets.evaluation.code_version import code_version

    path, _ = checked_folder(directory, lambda name: True)
    written: list[str] = []

    def told(case: "Case") -> None:
        written.append(case.name)
        if not as_json:
            click.echo(f"[{len(written)}] {case.name}", err=True)

    with only_writer(journal_path(path), path):
        folder = claim_folder(directory, f"bench suite {suite}", NAMES, lambda path: False, "name a new folder")
        try:
            record = export_suite(cases, folder, Light(device, n_photons), code_version(), told)
        except KeyboardInterrupt:
            click.echo(f"interrupted; {len(written)} cases were written, the same command continues", err=True)
            return EXIT_INTERRUPTED
    console.line(
        f"result     {directory}: {len(cases)} cases of {suite}, {len(written)} written now; see README.md there"
    )
    console.record({"output": directory, "written": len(written), **record})
    return 0


def _cases(suite: str, plates: int | None, rows: str, seed: int | None = None) -> "list[Case]":
    from data_gen.suites.suites import suite_cases

    return suite_cases(suite, plates, tuple(filter(None, (row.strip() for row in rows.split(",")))), seed)


def _check_photons(n_photons: int | None) -> None:
    if n_photons is not None and not 1 <= n_photons <= 10**9:
        raise InputError(f"--n-photons {n_photons} is not between 1 and 1e9; leave it out for the suite's own")


def _claimed(output: str) -> Path:
    from cli.claims import claim_folder

    return claim_folder(output, "bench", OUTPUTS, lambda path: False, "name a new folder, or one of an earlier run")


def _lines(records: Sequence[Mapping[str, Any]], console: Console) -> list[dict[str, Any]]:
    """Print what each row says; returns one row per cell."""
    from nets.evaluation.bench.detector import detection
    from nets.evaluation.bench.table import bench_rows, bench_summary

    rows = bench_rows(records)
    for line in bench_summary(rows):
        console.line(_line(line))
    found = detection(rows)
    if found.wrong + found.good:
        console.line(f"stated     {found.line}")
    return rows


def _told(
    folder: Path,
    cases: "Sequence[Case]",
    records: Sequence[Mapping[str, Any]],
    about: Mapping[str, Any],
    console: Console,
    pictures: Any,
) -> list[dict[str, Any]]:
    """Write table and page, and print the table."""
    from cli.bench_report.page import write_bench_page
    from nets.evaluation.bench.found_numbers import covered_numbers, number_rows
    from nets.evaluation.bench.table import bench_summary
    from warp_caustics.io.json_file import write_json

    rows, numbers = _lines(records, console), number_rows(cases, records)
    if covered := covered_numbers(numbers):
        console.line(
            f"numbers    of {len(numbers)} that images told of their benches {covered[0]:.0%} are within one standard "
            f"deviation, {covered[1]:.0%} within two"
        )
    found = {"about": about, "rows": rows, "summary": bench_summary(rows), "numbers": numbers}
    write_json(folder / "table.json", found)
    write_bench_page(folder / "index.html", rows, about, pictures)
    return rows


def _line(line: Mapping[str, Any]) -> str:
    name = f"{line['row']}, {line['method']}"
    if line["rmse_um"] is None:
        return f"{name:<36} failed"
    covered = (
        "" if line["within_one"] is None else f", within 1 / 2 u {line['within_one']:.2f} / {line['within_two']:.2f}"
    )
    warned = "" if line["warned"] is None else f", {line['warned']} warned"
    warned += "" if line["explained"] is None else f", {line['explained']} explained"
    time = "" if line["time_s"] is None else f", {line['time_s']:.3g} s"
    return (
        f"{name:<36} RMSE {line['rmse_um']:8.4g} um, aligned {line['rmse_aligned_um']:8.4g}, slopes "
        f"{line['slope_error']:.3g}{covered}{warned}{time}, {line['done']} of {line['plates']} plates"
    )
