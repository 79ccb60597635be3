"""How ``nsfc train`` shows a training: a bar on a terminal, now and then a line elsewhere."""

import contextlib
import math
import sys
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import rich_click as click

from cli.console import LOG_INTERVAL_S, Console, terminal_bar

if TYPE_CHECKING:
    from nets.training.progress import TrainingProgress


class _Lines:
    def __init__(self, console: Console):
        self.console = console
        self.last = -math.inf

    def note(self, text: str) -> None:
        click.echo(text, err=True)

    def warn(self, text: str) -> None:
        self.console.warn(text)

    def show(self, progress: "TrainingProgress") -> None:
        now = time.monotonic()
        if not progress.is_validation and now - self.last < LOG_INTERVAL_S:
            return
        if not progress.is_validation:
            self.last = now
        click.echo(f"[{progress.elapsed_s:7.1f} s] step {progress.step}: {figures(progress)}", err=True)


class _Silent(_Lines):
    def note(self, text: str) -> None:
        pass

    def show(self, progress: "TrainingProgress") -> None:
        pass


class _Bar(_Lines):
    def __init__(self, console: Console, bar: Any):
        super().__init__(console)
        self.bar = bar
        self.task = bar.add_task("preparing", total=1.0, text="")

    def note(self, text: str) -> None:
        self.bar.console.print(text, highlight=False)

    def warn(self, text: str) -> None:
        self.bar.console.print(f"warning: {text}", highlight=False)

    def show(self, progress: "TrainingProgress") -> None:
        if progress.is_validation:
            self.bar.console.print(f"step {progress.step}: {figures(progress)}", highlight=False)
            return
        values = {**progress.validation}
        shown = f"{figures(progress)}, {_validation(values)}" if values else figures(progress)
        self.bar.update(self.task, description=f"step {progress.step}", completed=progress.share or 0.0, text=shown)


def figures(progress: "TrainingProgress") -> str:
    """The figures of a report, on one line."""
    if progress.is_validation:
        return _validation(progress.validation)
    return (
        f"loss {progress.loss:.4g}, {progress.samples_per_s:.1f} samples/s, "
        f"{100 * progress.simulator_share:.0f} % in the simulator, rate {progress.learning_rate:.3g}"
    )


def _validation(values: dict[str, float]) -> str:
    names = {
        "val_rmse_um": "RMSE {:.4g} um",
        "val_median_rmse_um": "median {:.4g} um",
        "val_start_rmse_um": "start {:.4g} um",
        "val_first_rmse_um": "after one step {:.4g} um",
        "val_psnr_db": "PSNR {:.4g} dB",
        "val_noisy_psnr_db": "noisy {:.4g} dB",
        "val_loss": "loss {:.4g}",
    }
    return "validation " + ", ".join(text.format(values[name]) for name, text in names.items() if name in values)


@contextlib.contextmanager
def training_observer(console: Console, is_first: bool) -> Iterator[_Lines]:
    """What shows a training.

    Args:
        console: of the command.
        is_first: False for all processes of a run but one, which are silent.
    """
    if console.as_json or not is_first:
        yield _Silent(console)
    elif sys.stderr.isatty():
        from rich.progress import BarColumn, TextColumn, TimeElapsedColumn

        columns = (TextColumn("{task.description}"), BarColumn(20), TextColumn("{task.fields[text]}"))
        with terminal_bar(*columns, TimeElapsedColumn()) as bar:
            yield _Bar(console, bar)
    else:
        yield _Lines(console)
