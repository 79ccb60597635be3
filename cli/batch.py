"""Several images in one call: the method is made once, each result is written as soon as it is done."""

import os
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from cli.claims import claim_files
from cli.failures import explained
from cli.job import Job
from cli.output import check_apart, check_target, made_folder, result_names
from warp_caustics.errors import EXIT_INTERRUPTED
from warp_caustics.io.csv_table import CsvTable
from warp_caustics.io.journal import journal_path, only_writer

SUMMARY = "summary.csv"
COLUMNS = (
    "image", "status", "exit_code", "method", "residual", "rmse_um", "uncertainty_rms_um", "seconds", "warnings",
    "folder", "error",
)  # fmt: skip


def run_batch(job: Job, images: Sequence[str], output: str) -> int:
    """Reconstruct images one after another; one that fails does not stop the others.

    Ctrl-C ends the batch after the image at hand, whose best result so far is written.

    Args:
        job: everything but the images.
        images: their paths.
        output: folder; each result goes to a folder of the image's name in it, an overview to ``summary.csv``.

    Returns:
        The highest exit code of all images.

    Raises:
        InputError: images of one name, a result that exists, or no place for the folder.
        MismatchError: another batch writes there.
        DamagedDataError: its overview was replaced by something else.
    """
    names = result_names(images)
    folder = made_folder(output)
    inputs = {path for image in images for path in job.reads(image)}
    targets = {image: check_target(folder / names[image], job.force, job.kind, inputs) for image in images}
    table = CsvTable(folder / SUMMARY, COLUMNS)
    check_apart(table.path, inputs)
    _ = job.method  # what is wrong with it is wrong for all
    with only_writer(journal_path(table.path), folder):
        claim_files(folder, "batch", (SUMMARY,), table.is_own)
        if table.path.exists():
            table.read(is_exact=True)  # somebody may have put another table there since
        return _run(job, targets, table, output)


def _run(job: Job, targets: Mapping[str, Path], table: CsvTable, output: str) -> int:
    images = list(targets)
    rows: list[dict[str, Any]] = []
    records: list[dict[str, Any]] = []
    for number, image in enumerate(images, 1):
        job.console.line(f"[{number}/{len(images)}] {image}")
        row, record = _one(job, image, targets[image])
        rows.append(row)
        records.append(record)
        table.write(rows)
        if row["exit_code"] == EXIT_INTERRUPTED:
            click.echo(f"interrupted; {len(images) - number} images are left", err=True)
            break
    code: int = max(row["exit_code"] for row in rows)
    good = sum(row["status"] == "done" for row in rows)
    job.console.line(f"batch      {good} of {len(images)} images done; {os.path.join(output, SUMMARY)}")
    job.console.record({"exit_code": code, "output": output, "images": records})
    return code


def _one(job: Job, image: str, target: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Row of the summary and record of one image."""
    started = time.perf_counter()
    row: dict[str, Any] = {"image": image, "folder": str(target.name), "exit_code": 0, "status": "done"}
    record: dict[str, Any] = {}
    try:
        outcome = job.run(image, target, str(target))
    except KeyboardInterrupt:
        row |= {"status": "interrupted", "exit_code": EXIT_INTERRUPTED}
    except Exception as error:
        message, code = explained(error)
        row |= {"status": "failed", "exit_code": code, "error": " ".join(message.split())}
        click.echo(f"error: {image}: {row['error']}", err=True)
    else:
        record = dict(outcome.record)
        row |= {"method": record["method"], "residual": record["residual"], "warnings": len(record["warnings"])}
        row["rmse_um"] = record["errors"]["rmse_um"] if record["errors"] else None
        row["uncertainty_rms_um"] = record["uncertainty"]["rms_um"] if record["uncertainty"] else None
        if outcome.is_interrupted:
            row |= {"status": "interrupted", "exit_code": EXIT_INTERRUPTED}
    row["seconds"] = round(time.perf_counter() - started, 3)
    return row, {**row, "result": record or None}
