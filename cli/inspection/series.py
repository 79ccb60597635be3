"""Many plates of one design: a list of images, or a folder that is watched."""

import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from cli.failures import explained
from cli.inspection.plates import PLATES, TREND, Plates, plate_row, stamp
from cli.inspection.watch import Watcher
from cli.output import check_target, made_folder, result_names
from cli.provenance import file_sha256
from warp_caustics.errors import EXIT_INTERRUPTED
from warp_caustics.io.atomic import reason

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
    series = _Series(job, output)
    result_names(images)  # two of one name would share a folder
    job.method()  # what is wrong with it is wrong for all
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
    names = {os.path.basename(image) for image in images}
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
    series = _Series(job, output)
    job.method()
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


class _Series:
    """Table, folder and trend of a row of plates."""

    def __init__(self, job: "InspectionJob", output: str):
        self.job, self.folder = job, made_folder(output)
        self.plates = Plates(self.folder, job.settings)

    def inspect(self, image: str) -> int:
        """Inspect one image and list it; returns its exit code.

        Raises:
            KeyboardInterrupt: Ctrl-C; the image is not listed, the next start takes it up again.
        """
        started = time.perf_counter()
        row: dict[str, Any] = {"image": os.path.basename(image), "folder": Path(image).stem}
        try:
            before, row["sha256"] = stamp(image), file_sha256(image)
            row["modified"] = before.modified
            # A folder that the table does not vouch for is left from an image of other content or settings.
            target = check_target(self.folder / Path(image).stem, True, self.job.files_written)
            outcome = self.job.run(image, target, str(target), force=True)
            row |= plate_row(image, outcome.record, time.perf_counter() - started)
            row["exit_code"] = outcome.exit_code
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
