"""Several images in one call: the method is made once, each result is written as soon as it is done."""

import csv
import glob
import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from warp_caustics.errors import InputError
from warp_caustics.io.atomic import atomic_path, reason

if TYPE_CHECKING:
    from cli.reconstruct import Job

SUFFIXES = (".tif", ".tiff", ".png", ".exr", ".npy", ".npz", ".h5", ".hdf5")
"""Files of a folder that are taken for images."""

SUMMARY = "summary.csv"
COLUMNS = (
    "image", "status", "exit_code", "method", "residual", "rmse_um", "uncertainty_rms_um", "seconds", "warnings",
    "folder", "error",
)  # fmt: skip

EXIT_INTERRUPTED = 130


def image_list(images: Sequence[str]) -> str | list[str]:
    """The one image of a single reconstruction, or all those of a batch.

    Args:
        images: as given: files, folders (their images, not those of folders within) and patterns such as ``*.tif``.

    Raises:
        InputError: a folder or a pattern without images.
    """
    if len(images) == 1 and not os.path.isdir(images[0]) and (os.path.exists(images[0]) or not _is_pattern(images[0])):
        return images[0]
    found: list[str] = []
    for name in images:
        if os.path.isdir(name):
            entries = sorted(os.listdir(name))
            held = [os.path.join(name, entry) for entry in entries if entry.lower().endswith(SUFFIXES)]
            if not held:
                raise InputError(f"folder {name!r} holds no images ({', '.join(SUFFIXES)}); name images, or another")
        elif _is_pattern(name) and not os.path.exists(name):
            held = sorted(glob.glob(name))
            if not held:
                raise InputError(f"no file matches {name!r}; check the pattern")
        else:
            held = [name]
        found += [path for path in held if path not in found]
    return found


def _is_pattern(name: str) -> bool:
    return any(character in name for character in "*?[")


def run_batch(job: "Job", images: Sequence[str], output: str) -> int:
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
    """
    folder = _batch_folder(output)
    targets = _targets(images, folder, job.force)
    job.method()  # what is wrong with it is wrong for all
    rows: list[dict[str, Any]] = []
    records: list[dict[str, Any]] = []
    for number, image in enumerate(images, 1):
        job.console.line(f"[{number}/{len(images)}] {image}")
        row, record = _one(job, image, targets[image])
        rows.append(row)
        records.append(record)
        _write_summary(folder / SUMMARY, rows)
        if row["exit_code"] == EXIT_INTERRUPTED:
            click.echo(f"interrupted; {len(images) - number} images are left", err=True)
            break
    code: int = max(row["exit_code"] for row in rows)
    good = sum(row["status"] == "done" for row in rows)
    job.console.line(f"batch      {good} of {len(images)} images done; {os.path.join(output, SUMMARY)}")
    job.console.record({"exit_code": code, "output": output, "images": records})
    return code


def _one(job: "Job", image: str, target: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Row of the summary and record of one image."""
    from cli.main import explained

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


def _batch_folder(output: str) -> Path:
    folder = Path(os.path.realpath(output))
    if not folder.parent.is_dir():
        raise InputError(f"folder {str(folder.parent)!r} does not exist; create it first")
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise InputError(f"output {output!r} cannot be made a folder ({reason(error)}); name another") from error
    return folder


def _targets(images: Sequence[str], folder: Path, force: bool) -> dict[str, Path]:
    """Result folder of each image, all checked before the first is made."""
    from cli.results import check_target

    owners: dict[str, str] = {}
    targets = {}
    for image in images:
        stem = Path(image).stem
        if stem in owners:
            raise InputError(
                f"{owners[stem]!r} and {image!r} would both go to the folder {stem!r}; rename one, or make two calls"
            )
        owners[stem] = image
        targets[image] = check_target(folder / stem, force)
    return targets


def _write_summary(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    with atomic_path(path) as temporary, open(temporary, "w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows(rows)
