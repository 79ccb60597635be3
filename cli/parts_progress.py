"""Work in parts of much the same length (fields, trials, cells): how many are done, how fast, and what time is left."""

import math
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import rich_click as click

from cli.console import LOG_INTERVAL_S, Console, about, terminal_bar

QUIET_S = 5.0
"""What is done within this time needs no progress."""

Told = Callable[[int, int], None]
"""Takes the number of parts done and of all."""


class PartsPace:
    """Rate of parts since the first was begun.

    Args:
        done: parts that were done before.
    """

    def __init__(self, done: int = 0):
        self.before, self.start_s = done, time.monotonic()

    def __call__(self, done: int, total: int) -> str:
        """Rate and time left; empty before the first part is done, and within the first seconds."""
        spent_s, fresh = time.monotonic() - self.start_s, done - self.before
        if fresh < 1 or spent_s < QUIET_S:
            return ""
        rate, left_s = fresh / spent_s, (total - done) * spent_s / fresh
        speed = f"{rate:.3g}/s" if rate >= 1 else f"{60 * rate:.3g}/min"
        return f"{speed}, {about(left_s)} left" if total > done else speed


@contextmanager
def parts_progress(console: Console, what: str) -> Iterator[Told]:
    """What shows parts: a bar on a terminal, elsewhere a line now and then; nothing with ``--json``.

    Args:
        console: of the command.
        what: the parts, in plain words.
    """
    pace = PartsPace()
    if console.as_json:
        yield lambda done, total: None
    elif sys.stderr.isatty():
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn

        columns = (TextColumn(what), BarColumn(20), MofNCompleteColumn(), TextColumn("{task.fields[text]}"))
        with terminal_bar(*columns) as bar:
            task = bar.add_task(what, total=None, text="")

            def show(done: int, total: int) -> None:
                bar.update(task, completed=done, total=total, text=pace(done, total))

            yield show
    else:
        last = -math.inf

        def echo(done: int, total: int) -> None:
            nonlocal last
            text, now = pace(done, total), time.monotonic()
            if text and done < total and now - last >= LOG_INTERVAL_S:
                last = now
                click.echo(f"{what}: {done} of {total}, {text}", err=True)

        yield echo
