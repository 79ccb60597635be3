"""What a command says: lines and warnings for people, one JSON record for programs."""

import math
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import rich_click as click

if TYPE_CHECKING:
    from data_gen.store.progress import Progress as BuildProgress
    from warp_caustics.reconstruct.base import Progress, ProgressCallback

LOG_INTERVAL_S = 10.0
"""Least time between two progress lines where there is no terminal."""

_PACE_ITERATIONS = 16
"""Iterations over which a rate is taken: steady enough to read, quick to follow changes."""


_ESTIMATE_ITERATIONS, _ESTIMATE_S = 3, 1.0
"""Iterations, and time that they took [s], after which the time of a stage is told: the first compiles and plans."""


class Console:
    """Output of one command.

    Results go to stdout, progress and warnings to stderr. With ``as_json``
    stdout holds one record and nothing else, and no progress is shown.
    """

    def __init__(self, as_json: bool = False):
        self.as_json = as_json

    def line(self, *lines: str) -> None:
        """Lines of the result, for people."""
        if not self.as_json:
            for text in lines:
                click.echo(text)

    def warn(self, *lines: str) -> None:
        """What the user should know."""
        for text in lines:
            click.echo(f"warning: {text}", err=True)

    def record(self, record: Mapping[str, Any]) -> None:
        """The result, for programs."""
        if self.as_json:
            from warp_caustics.io.json_file import json_text

            click.echo(json_text(record))

    @contextmanager
    def progress(self) -> Iterator["ProgressCallback"]:
        """Shows the progress of a reconstruction: a bar on a terminal, now and then a line elsewhere."""
        if self.as_json:
            yield lambda state: None
        elif sys.stderr.isatty():
            with _bar() as show:
                yield show
        else:
            yield _log_lines()

    @contextmanager
    def sample_progress(self) -> Iterator[tuple["Callable[[BuildProgress], None]", Callable[[str], None]]]:
        """Shows how a data set grows, and what was mended: a bar on a terminal, now and then a line elsewhere."""
        if self.as_json:
            yield (lambda state: None), self.warn
        elif sys.stderr.isatty():
            with _sample_bar() as show:
                yield show, self.warn
        else:
            yield _sample_lines(), self.warn


def terminal_bar(*columns: Any) -> Any:
    """A bar of rich on stderr, which is gone when the work is done."""
    from rich.console import Console as RichConsole
    from rich.progress import Progress as RichProgress

    return RichProgress(*columns, console=RichConsole(stderr=True), transient=True)


@contextmanager
def _bar() -> Iterator[Callable[["Progress"], None]]:
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[residual]}"),
        TimeElapsedColumn(),
        TextColumn("{task.fields[pace]}"),
    )
    with terminal_bar(*columns) as bar:
        task, pace = bar.add_task("preparing", total=None, residual="", pace=""), _Pace()

        def show(state: "Progress") -> None:
            bar.update(
                task,
                description=state.stage,
                completed=state.iteration,
                total=state.total,
                residual=_residual(state),
                pace=pace(state),
            )

        yield show


class _Pace:
    """Rate of a reconstruction and the time it may still take, from its last iterations at the present stage."""

    def __init__(self) -> None:
        self.stage = ""
        self.recent: deque[tuple[float, int]] = deque(maxlen=_PACE_ITERATIONS)

    def stage_s(self, state: "Progress") -> float | None:
        """Time that the whole stage takes at most [s]; None before enough iterations to tell."""
        (first_s, first), (last_s, last) = self.recent[0], self.recent[-1]
        if len(self.recent) < _ESTIMATE_ITERATIONS or last <= first or last_s - first_s < _ESTIMATE_S:
            return None
        return (last_s - first_s) / (last - first) * state.total

    def __call__(self, state: "Progress") -> str:
        if state.stage != self.stage:
            # Iterations of another stage take another time.
            self.stage = state.stage
            self.recent.clear()
        self.recent.append((state.elapsed_s, state.iteration))
        (first_s, first), (last_s, last) = self.recent[0], self.recent[-1]
        if last <= first or last_s <= first_s:
            return ""
        rate = (last - first) / (last_s - first_s)
        left = max(0, state.total - last)
        # The total is an upper bound: most methods stop before.
        return f"{rate:.3g}/s" + (f", at most {clock(left / rate)} left" if left else "")


def _residual(state: "Progress", before: str = "") -> str:
    """Nothing where it is not known, as before a network's answer is simulated."""
    return f"{before}residual {state.residual:.4f}" if math.isfinite(state.residual) else ""


def _log_lines() -> Callable[["Progress"], None]:
    last: tuple[str, float] = ("", -math.inf)
    pace, estimated = _Pace(), ""

    def show(state: "Progress") -> None:
        nonlocal last, estimated
        speed = pace(state)
        if state.stage != estimated and (wait_s := pace.stage_s(state)) is not None:
            estimated = state.stage
            if wait_s > LOG_INTERVAL_S:
                click.echo(f"estimate   {state.stage}: at most {about(wait_s)} on this machine", err=True)
        if state.stage == last[0] and state.elapsed_s - last[1] < LOG_INTERVAL_S:
            return
        last = state.stage, state.elapsed_s
        click.echo(
            f"[{state.elapsed_s:7.1f} s] {state.stage}: {state.iteration} of {state.total}"
            f"{_residual(state, ', ')}{', ' * bool(speed)}{speed}",
            err=True,
        )

    return show


@contextmanager
def _sample_bar() -> Iterator[Callable[["BuildProgress"], None]]:
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn

    columns = (
        TextColumn("samples"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]:.1f}/s"),
        TextColumn("{task.fields[left]}"),
    )
    with terminal_bar(*columns) as bar:
        task = bar.add_task("samples", total=None, rate=0.0, left="")

        def show(state: "BuildProgress") -> None:
            bar.update(task, completed=state.done, total=state.total, rate=state.rate, left=_time_left(state))

        yield show


def _sample_lines() -> Callable[["BuildProgress"], None]:
    last = -math.inf

    def show(state: "BuildProgress") -> None:
        nonlocal last
        now = time.monotonic()
        if now - last < LOG_INTERVAL_S and state.done < state.total:
            return
        last = now
        click.echo(f"{state.done} of {state.total} samples, {state.rate:.1f}/s{_time_left(state, ', ')}", err=True)

    return show


def _time_left(state: "BuildProgress", before: str = "") -> str:
    if state.eta_s is None or state.done == state.total:
        return ""
    return f"{before}{clock(state.eta_s)} left"


def clock(seconds: float) -> str:
    """A time as ``h:mm:ss``."""
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02d}:{rest:02d}"


def about(seconds: float) -> str:
    """A time in words, for estimates."""
    if seconds < 90:
        return f"about {max(1, round(seconds))} s"
    if seconds < 5400:
        return f"about {seconds / 60:.0f} min"
    return f"about {seconds / 3600:.2g} h" if seconds < 48 * 3600 else f"about {seconds / 86400:.0f} days"
