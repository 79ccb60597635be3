"""Many plates of one design: a list of images, or a folder that is watched."""

import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from cli.claims import claim_files
from cli.failures import explained
from cli.inspection.plates import PLATES, TREND, Plates, listed_name, plate_row, stamp
from cli.inspection.watch import Watcher
from cli.output import check_apart, check_target, made_folder, result_name, result_names
from warp_caustics.errors import EXIT_INTERRUPTED
from warp_caustics.io.atomic import reason
from warp_caustics.io.journal import journal_path, only_writer
from warp_caustics.io.printable import printable

if TYPE_CHECKING:
    from cli.inspection.job import InspectionJob


def run_series(job: "InspectionJob", images: Sequence[str], output: str) -> int:
    """Inspect images one after another; one that fails does not stop the others.

    Images that ``plates.csv`` lists already, with the same content and settings, are skipped.

    Args:
        job: everything but the images.
        images: their paths.
        output: folder; each result goes to a folder of the image's name in it.

    Returns:
        The highest exit code of all images.

    Raises:
        InputError: images of one name, or no place for the folder.
    """
    result_names(images)  # two of one name would share a folder
    with _series(job, output) as series:
        for image in images:
            check_apart(series.target(image), job.reads(image))
        job.method()  # what is wrong with it is wrong for all
        return _run(series, images, output)


def _run(series: "_Series", images: Sequence[str], output: str) -> int:
    job = series.job
    codes: list[int] = []
    for number, image in enumerate(images, 1):
        job.console.line(f"[{number}/{len(images)}] {image}")
        if not job.force and os.path.exists(image) and series.plates.is_done(image):
            codes.append(int((series.plates.row_of(image) or {})["exit_code"]))
            job.console.line("           listed already, skipped; --force inspects it again")
            continue
        try:
            codes.append(series.inspect(image))
        except KeyboardInterrupt:
            click.echo(f"interrupted; {len(images) - number + 1} images are left", err=True)
            codes.append(EXIT_INTERRUPTED)
            break
    job.console.line(f"plates     {os.path.join(output, PLATES)}, {TREND}")
    names = {listed_name(image) for image in images}
    rows = [row for row in series.plates.rows if row["image"] in names]
    job.console.record({"exit_code": max(codes), "output": output, "plates": rows})
    return max(codes)


def run_watch(
    job: "InspectionJob", folder: str, output: str, seconds: float, sleep: Callable[[float], None] = time.sleep
) -> int:
    """Inspect every image that appears in a folder, until Ctrl-C.

    Args:
        job: everything but the images.
        folder: where images appear.
        output: as for :func:`run_series`.
        seconds: time between two looks [s].
        sleep: waits.

    Returns:
        130: only Ctrl-C ends it.
    """
    with _series(job, output) as series:
        job.method()
        return _watch(series, folder, output, seconds, sleep)


def _watch(series: "_Series", folder: str, output: str, seconds: float, sleep: Callable[[float], None]) -> int:
    job = series.job
    watcher = Watcher(folder, series.plates.is_done)
    job.console.line(f"watching   {folder} every {seconds:g} s; Ctrl-C ends it")
    try:
        while True:
            try:
                ready = watcher.look()
            except OSError as error:
                job.console.warn(f"{folder!r} cannot be listed ({reason(error)}); trying again")
                ready = []
            for image in ready:
                job.console.line(f"new        {image}")
                series.inspect(image)
            sleep(seconds)
    except KeyboardInterrupt:
        done = len(series.plates.rows)
        click.echo(f"interrupted; {done} plates are in {os.path.join(output, PLATES)}", err=True)
        return EXIT_INTERRUPTED


@contextmanager
def _series(job: "InspectionJob", output: str) -> Iterator["_Series"]:
    """A row of plates that nobody else adds to, in a folder whose table is of an earlier one or none."""
    folder = made_folder(output)
    with only_writer(journal_path(folder / PLATES), folder):
        series = _Series(job, folder)
        claim_files(folder, "series", (PLATES, TREND), series.plates.table.is_own)
        yield series


class _Series:
    """Table, folder and trend of a row of plates."""

    def __init__(self, job: "InspectionJob", folder: Path):
        self.job, self.folder = job, folder
        self.plates = Plates(folder, job.settings, job.content)

    def target(self, image: str) -> Path:
        """Folder of an image's result."""
        return self.folder / result_name(image)

    def inspect(self, image: str) -> int:
        """Inspect one image and list it; returns its exit code.

        Raises:
            KeyboardInterrupt: Ctrl-C; the image is not listed, the next start takes it up again.
        """
        started = time.perf_counter()
        row: dict[str, Any] = {"image": listed_name(image), "folder": printable(result_name(image))}
        try:
            before, content = stamp(image), self.job.content(image)
            row |= {"modified": before.modified, "sha256": content}
            # A folder that the table does not vouch for is left from an image of other content or settings.
            target = check_target(self.target(image), True, self.job.kind, self.job.reads(image))
            outcome = self.job.run(image, target, str(target), force=True)
            row |= plate_row(image, outcome.record, time.perf_counter() - started)
            row["exit_code"] = outcome.exit_code
            if self.job.content(image) != content:
                row["sha256"] = ""  # nobody can say which of two the verdict is of
                self.job.console.warn(f"{image!r} was changed while it was inspected; the next start inspects it again")
        except Exception as error:
            message, code = explained(error)
            row |= {"status": "failed", "exit_code": code, "error": " ".join(message.split())}
            row["seconds"] = f"{time.perf_counter() - started:.1f}"
            click.echo(f"error: {image}: {row['error']}", err=True)
        self.plates.add(image, row)
        self._draw_trend()
        return int(row["exit_code"])

    def _draw_trend(self) -> None:
        from cli.figures import write_figure
        from cli.inspection.trend import trend_figure

        write_figure(self.folder / TREND, trend_figure(self.plates.rows, self.job.tolerance_m))
