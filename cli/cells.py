"""What people are told of cells: each as it is computed, and those that failed."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import rich_click as click

from cli.console import Console
from warp_caustics.errors import EXIT_BUG

if TYPE_CHECKING:
    from nets.evaluation.cells import Cell


class CellProgress:
    """A line for every cell computed.

    Attributes:
        done: how many were computed now.
    """

    def __init__(self, console: Console):
        self.console, self.done = console, 0

    def __call__(self, cell: "Cell", record: Mapping[str, Any]) -> None:
        self.done += 1
        if record["status"] == "failed":
            self.console.warn(f"{cell.title}: failed, {record['reason']}")
        elif not self.console.as_json:
            scores = record["scores"]
            click.echo(
                f"[{self.done}] {cell.title}: RMSE {scores['rmse_um']:.4g} um, {record['time_s']:.3g} s", err=True
            )


def failure_reasons(failed: Sequence[Mapping[str, Any]]) -> str:
    """One reason per method, the first."""
    first: dict[str, str] = {}
    for record in failed:
        first.setdefault(record["method"], record["reason"])
    return "; ".join(f"{method}: {reason}" for method, reason in first.items())


def worst_code(failed: Sequence[Mapping[str, Any]]) -> int:
    """A bug is worse than anything a person can mend; else the highest code."""
    codes = {int(record["exit_code"]) for record in failed}
    return EXIT_BUG if EXIT_BUG in codes else max(codes)
