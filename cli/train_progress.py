"""How ``nsfc train`` shows a training: a bar on a terminal, now and then a line elsewhere."""

import contextlib
import math
import sys
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import rich_click as click

from cli.console import LOG_INTERVAL_S, Console, about, clock, terminal_bar

if TYPE_CHECKING:
    from nets.training.progress import TrainingProgress


ESTIMATE_STEPS = 3
"""Steps after which the time of a step is told: the first one compiles kernels and plans memory."""


class _Lines:
    def __init__(self, console: Console, outlook: "Outlook"):
        self.console, self.outlook = console, outlook
        self.last = -math.inf
        self.what, self.told = "", set[str]()
        self.pace = Pace()

    def stage(self, what: str, done: int, total: int) -> None:
        now = time.monotonic()
        if what in self.told and (done == 0 or now - self.last < LOG_INTERVAL_S):
            return
        self.last = now
        self.told.add(what)
        click.echo(f"{what}{_counted(done, total)}", err=True)

    def tick(self, step: int, share: float | None, left_s: float | None) -> None:
        for line in self.outlook(step, self.pace(step)):
            self.note(line)
        now = time.monotonic()
        if self.pace.steps > 1 and now - self.last < LOG_INTERVAL_S:
            return
        self.last = now
        click.echo(f"step {step}{_ahead(self.pace, left_s, ', ')}", err=True)

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
    def stage(self, what: str, done: int, total: int) -> None:
        pass

    def tick(self, step: int, share: float | None, left_s: float | None) -> None:
        pass

    def note(self, text: str) -> None:
        pass

    def show(self, progress: "TrainingProgress") -> None:
        pass


class _Bar(_Lines):
    def __init__(self, console: Console, outlook: "Outlook", bar: Any):
        super().__init__(console, outlook)
        self.bar, self.figures = bar, ""
        self.task = bar.add_task("preparing", total=None, text="")

    def stage(self, what: str, done: int, total: int) -> None:
        self.bar.update(self.task, description=f"{what}{_counted(done, total)}", total=total or None, completed=done)

    def tick(self, step: int, share: float | None, left_s: float | None) -> None:
        for line in self.outlook(step, self.pace(step)):
            self.note(line)
        text = f"{_ahead(self.pace, left_s)}{', ' * bool(self.figures)}{self.figures}"
        total = None if share is None else 1.0
        self.bar.update(self.task, description=f"step {step}", total=total, completed=share or 0.0, text=text)

    def note(self, text: str) -> None:
        self.bar.console.print(text, highlight=False)

    def warn(self, text: str) -> None:
        self.bar.console.print(f"warning: {text}", highlight=False)

    def show(self, progress: "TrainingProgress") -> None:
        if progress.is_validation:
            self.bar.console.print(f"step {progress.step}: {figures(progress)}", highlight=False)
            return
        values = {**progress.validation}
        self.figures = f"{figures(progress)}, {_validation(values)}" if values else figures(progress)


class Pace:
    """Time of a step, from the last ones; the first, which compiles, does not count."""

    def __init__(self) -> None:
        self.steps = 0
        self.recent: deque[tuple[float, int]] = deque(maxlen=32)

    def __call__(self, step: int) -> "Pace":
        """A step was done."""
        self.steps += 1
        self.recent.append((time.monotonic(), step))
        return self

    @property
    def step_s(self) -> float | None:
        """Time of a step [s]; None before there are two."""
        if len(self.recent) < 2:
            return None
        (first_s, first), (last_s, last) = self.recent[0], self.recent[-1]
        return (last_s - first_s) / (last - first) if last > first else None


@dataclass
class Outlook:
    """What a training is about to cost, told once.

    Attributes:
        epoch_steps: steps until the first validation; None where it is not known.
        total_steps: of the run; None where it ends otherwise.
        shipped_steps: steps of the network of this kind that ships, which a GPU made; None for none, or on a GPU.
    """

    epoch_steps: int | None = None
    total_steps: int | None = None
    shipped_steps: int | None = None

    def __call__(self, step: int, pace: Pace) -> list[str]:
        """Lines, after enough steps; nothing before and after."""
        seconds = pace.step_s
        if pace.steps != ESTIMATE_STEPS or seconds is None:
            return []
        parts = [f"estimate   {seconds:.2g} s a step"]
        if self.total_steps is not None:
            parts.append(f"all {self.total_steps} {about(self.total_steps * seconds)}")
        elif self.epoch_steps is not None:
            parts.append(f"first validation after {self.epoch_steps}, {about(self.epoch_steps * seconds)}")
        lines = [", ".join(parts)]
        if self.shipped_steps is not None and self.shipped_steps * seconds > 3600:
            lines.append(
                f"on a CPU   the network that ships took {self.shipped_steps} steps on a GPU, here "
                f"{about(self.shipped_steps * seconds)}; train on a GPU, or try things out with --config small"
            )
        return lines


def _counted(done: int, total: int) -> str:
    return f": {done} of {total}" if total else ""


def _ahead(pace: Pace, left_s: float | None, before: str = "") -> str:
    parts = [] if pace.step_s is None else [f"{1 / max(pace.step_s, 1e-9):.3g} steps/s"]
    parts += [] if left_s is None else [f"{clock(left_s)} left"]
    return before * bool(parts) + ", ".join(parts)


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
def training_observer(console: Console, is_first: bool, outlook: Outlook | None = None) -> Iterator[_Lines]:
    """What shows a training.

    Args:
        console: of the command.
        is_first: False for all processes of a run but one, which are silent.
        outlook: what is known of the run's length.
    """
    outlook = outlook or Outlook()
    if console.as_json or not is_first:
        yield _Silent(console, outlook)
    elif sys.stderr.isatty():
        from rich.progress import BarColumn, TextColumn, TimeElapsedColumn

        columns = (TextColumn("{task.description}"), BarColumn(20), TextColumn("{task.fields[text]}"))
        with terminal_bar(*columns, TimeElapsedColumn()) as bar:
            yield _Bar(console, outlook, bar)
    else:
        yield _Lines(console, outlook)
