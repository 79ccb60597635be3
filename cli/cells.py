"""What people are told of cells: each as it is computed, and those that failed."""

import time
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import rich_click as click

from cli.console import Console, about
from cli.parts_progress import QUIET_S
from warp_caustics.errors import EXIT_BUG

if TYPE_CHECKING:
    from nets.evaluation.cells import Cell


class CellProgress:
    """A line for every cell computed; once all methods have been seen, the time left as well.

    Args:
        console: of the command.
        cells: to be computed; None where that is found out on the way, and neither number nor time left is told.

    Attributes:
        done: how many were computed now.
    """

    def __init__(self, console: Console, cells: "Sequence[Cell] | None" = None):
        self.console, self.done = console, 0
        self.total = "" if cells is None else f" of {len(cells)}"
        self.left = Counter(map(_kind, cells or ()))
        self.times_s: dict[tuple[str, str], list[float]] = {}
        self.start_s = time.monotonic()

    def __call__(self, cell: "Cell", record: Mapping[str, Any]) -> None:
        self.done += 1
        self.left[_kind(cell)] -= 1
        # What failed at once tells nothing of how long others take; yet another will hardly do better.
        self.times_s.setdefault(_kind(cell), []).append(float(record.get("time_s") or 0.0))
        if record["status"] == "failed":
            self.console.warn(f"{cell.title}: failed, {record['reason']}")
        elif not self.console.as_json:
            scores = record["scores"]
            click.echo(
                f"[{self.done}{self.total}] {cell.title}: RMSE {scores['rmse_um']:.4g} um, "
                f"{record['time_s']:.3g} s{self._ahead()}",
                err=True,
            )

    def _ahead(self) -> str:
        """Methods differ a thousandfold: each counts with its own mean, and nothing is said before all are known."""
        if not self.total:
            return ""
        left_s = remaining_s(self.left, self.times_s, time.monotonic() - self.start_s)
        return "" if left_s is None else f", {about(left_s)} left"


def _kind(cell: "Cell") -> tuple[str, str]:
    """Cells of one kind take much the same time."""
    return cell.spec.label, cell.budget


def remaining_s(
    left: Mapping[tuple[str, str], int], times_s: Mapping[tuple[str, str], Sequence[float]], spent_s: float
) -> float | None:
    """Time that cells still take [s]; None where it is not known, and where nothing or little is to be waited for.

    Args:
        left: how many of each kind (method, iterations) are to be computed.
        times_s: what the methods took in those computed [s].
        spent_s: on all of these, with images simulated again and scores, by all processes.
    """
    measured_s = sum(map(sum, times_s.values()))
    if spent_s < QUIET_S or measured_s <= 0 or any(count and kind not in times_s for kind, count in left.items()):
        return None
    expected_s = sum(count * sum(times_s[kind]) / len(times_s[kind]) for kind, count in left.items() if count)
    return expected_s * spent_s / measured_s or None


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
