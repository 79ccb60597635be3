"""How ``nsfc search`` shows its trials: a line for each, and a bar on a terminal."""

import contextlib
import sys
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import rich_click as click

from cli.console import Console, terminal_bar
from cli.parts_progress import PartsPace

if TYPE_CHECKING:
    import optuna
    from optuna.trial import FrozenTrial

Show = Callable[["optuna.Study"], None]


@contextlib.contextmanager
def search_progress(console: Console, study: "optuna.Study", n_trials: int) -> Iterator[Show]:
    """What shows a search.

    Args:
        console: of the command.
        study: as it is now; its trials so far are not told again.
        n_trials: finished trials in the end.
    """
    from nets.search.study import count

    told = {trial.number for trial in study.get_trials(deepcopy=False) if trial.state.is_finished()}
    pace = PartsPace(count(study).finished)
    if console.as_json:
        yield lambda study: None
    elif sys.stderr.isatty():
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn

        columns = (TextColumn("trials"), BarColumn(20), MofNCompleteColumn(), TextColumn("{task.fields[text]}"))
        with terminal_bar(*columns, TimeElapsedColumn()) as bar:
            task = bar.add_task("trials", total=n_trials, text="")

            def show(study: "optuna.Study") -> None:
                for line in new_lines(study, told):
                    bar.console.print(line, highlight=False)
                counts = count(study)
                ahead = pace(counts.finished, n_trials)
                text = f"{counts.running} running{', ' * bool(ahead)}{ahead}"
                bar.update(task, completed=counts.finished, text=text)

            show(study)
            yield show
    else:

        def echo(study: "optuna.Study") -> None:
            lines = new_lines(study, told)
            if lines:
                ahead = pace(count(study).finished, n_trials)
                lines[-1] += f"; {count(study).finished} of {n_trials} trials, {ahead}" if ahead else ""
            for line in lines:
                click.echo(line, err=True)

        yield echo


def new_lines(study: "optuna.Study", told: set[int]) -> list[str]:
    """A line for each trial that is finished and was not told of; their numbers are added to ``told``."""
    from nets.search.report import best_trial
    from nets.search.study import retried_numbers

    trials = study.get_trials(deepcopy=False)
    fresh = [trial for trial in trials if trial.state.is_finished() and trial.number not in told]
    fresh.sort(key=lambda trial: (trial.datetime_complete is None, trial.datetime_complete))
    told.update(trial.number for trial in fresh)
    best, again = best_trial(trials), retried_numbers(trials)
    return [trial_line(trial, best, again) for trial in fresh]


def trial_line(trial: "FrozenTrial", best: "FrozenTrial | None", retried: set[int]) -> str:
    """One finished trial, for people."""
    from nets.search.report import reason_of

    seconds = trial.duration.total_seconds() if trial.duration is not None else 0.0
    parts: list[Any] = [f"trial {trial.number}: {trial.state.name.lower()}"]
    if trial.state.name == "COMPLETE":
        is_best = best is not None and best.number == trial.number
        parts = [f"trial {trial.number}: loss {trial.value:.4g}{' (best)' if is_best else ''}"]
        if best is not None and not is_best:
            parts.append(f"best {best.value:.4g} of trial {best.number}")
    else:
        parts.append(reason_of(trial, retried))
    if trial.number in retried:
        parts.append("queued again")
    parts += [f"{len(trial.intermediate_values)} epochs", f"{seconds:.1f} s"]
    if "parameters" in trial.user_attrs:
        parts.append(f"{trial.user_attrs['parameters']:,} parameters")
    return ", ".join(parts)
