"""What a search leaves for people: the best configuration, a table of all trials, a page with pictures.

Every file is written whole or not at all, after every trial, by the worker that
ended it. The page takes a second or two to draw, so between two of them lies
twenty times as long, until the search is at its end.
"""

import base64
import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import optuna
import yaml
from optuna.trial import FrozenTrial, TrialState

from nets.config import NetworkConfig
from nets.search import figures
from nets.search.config import SearchConfig, trial_run
from nets.search.space import described_ranges, distributions, keys
from nets.search.study import count, retried_numbers
from nets.search.worker import FileLock
from warp_caustics.io.atomic import atomic_path
from warp_caustics.io.csv_table import CsvTable
from warp_caustics.io.page import render_page

BEST, NETWORK, TRIALS, REPORT = "best.yaml", "network.yaml", "trials.csv", "report.html"
FILES = (BEST, NETWORK, TRIALS, REPORT)
COLUMNS = (
    "number", "state", "loss", "epochs", "seconds", "parameters", "reason", "retry_of", "worker", "sampler_seed",
)  # fmt: skip
"""Of trials.csv; the numbers of Tab. 2 follow."""
BETWEEN_PAGES = 20
"""Time between two pages, in times that drawing one took."""

_drawn: dict[Path, tuple[float, float]] = {}
"""By folder: when the page was drawn, and how long that took [s]."""


def write_outputs(folder: Path, study: optuna.Study, search: SearchConfig, *, is_last: bool = False) -> None:
    """Bring all files up to date.

    Args:
        folder: of the search.
        study: with its trials.
        search: what it searches.
        is_last: draw the page in any case.
    """
    # Whoever comes later has seen more trials: without the lock an older table could replace a newer one.
    lock = FileLock(folder / ".outputs.lock")
    try:
        lock.acquire()
        trials = study.get_trials(deepcopy=False)
        CsvTable(folder / TRIALS, (*COLUMNS, *keys(search.kind))).write(trial_rows(trials, search))
        winner = best_trial(trials)
        if winner is not None:
            _write(folder / BEST, best_text(winner, search))
            _write(folder / NETWORK, network_text(winner, search))
        now = time.monotonic()
        at, took = _drawn.get(folder, (-1e9, 0.0))
        if is_last or now - at >= BETWEEN_PAGES * took:
            _write(folder / REPORT, page(study, search))
            _drawn[folder] = time.monotonic(), time.monotonic() - now
    finally:
        lock.close()


def best_trial(trials: Sequence[FrozenTrial]) -> FrozenTrial | None:
    """The complete trial of the lowest loss, the first of equals; None if there is none."""
    done = [trial for trial in trials if trial.state == TrialState.COMPLETE and trial.value is not None]
    return min(done, key=lambda trial: (trial.value, trial.number), default=None)


def best_text(trial: FrozenTrial, search: SearchConfig) -> str:
    """The winner's run, as YAML for ``nsfc train --config``; trained with it, it gives the same loss again."""
    config = trial_run(search, trial.params, trial.user_attrs.get("steps") or 1)
    fixed = search.run.training.fixed_samples
    lines = [
        f"# Trial {trial.number} of a search: validation loss {trial.value:.9g}.",
        f"# nsfc train {search.kind} {'DATA' if search.run.data else '--fresh'} --config {BEST} -o RUN repeats it.",
        f"# For a real training add --total-steps{' and --set training.fixed_samples=0' if fixed else ''}.",
    ]
    tree = config.model_dump(mode="json")
    # In a configuration file "data" would be the section of nsfc data build; the command names the data set.
    tree.pop("data")
    return "\n".join(lines) + "\n" + _yaml(tree)


def network_text(trial: FrozenTrial, search: SearchConfig) -> str:
    """The winner's numbers of Tab. 2 alone, which go with any scene and data."""
    numbers = NetworkConfig(**trial.params).model_dump(mode="json", exclude_none=True)
    return f"# Trial {trial.number} of a search: validation loss {trial.value:.9g}.\n" + _yaml({search.kind: numbers})


def trial_rows(trials: Sequence[FrozenTrial], search: SearchConfig) -> list[dict[str, Any]]:
    """Of trials.csv, one per trial."""
    again = retried_numbers(list(trials))
    return [
        {
            "number": trial.number,
            "state": f"{trial.state.name.lower()}{', retried' if trial.number in again else ''}",
            "loss": "" if trial.value is None else f"{trial.value:.9g}",
            "epochs": len(trial.intermediate_values),
            "seconds": "" if trial.duration is None else f"{trial.duration.total_seconds():.2f}",
            "parameters": trial.user_attrs.get("parameters", ""),
            "reason": reason_of(trial, again),
            "retry_of": trial.system_attrs.get("failed_trial", ""),
            "worker": trial.user_attrs.get("worker", ""),
            "sampler_seed": trial.user_attrs.get("sampler_seed", ""),
            **{name: trial.params.get(name, "") for name in keys(search.kind)},
        }
        for trial in trials
    ]


def reason_of(trial: FrozenTrial, retried: set[int]) -> str:
    """Why a trial was pruned or failed."""
    told = trial.user_attrs.get("reason") or trial.user_attrs.get("stopped_by", "")
    is_silent = trial.state == TrialState.FAIL and not told
    return "its worker died" if is_silent or (trial.number in retried and not told) else str(told)


def page(study: optuna.Study, search: SearchConfig) -> str:
    """The report, one HTML file with its pictures inside."""
    trials = study.get_trials(deepcopy=False)
    space = distributions(search.kind)
    shares, bars = figures.importances(study)
    pictures = [
        ("Loss over trials", figures.history(trials)),
        ("Loss over epochs", figures.curves(trials)),
        ("Loss over each number; grey: pruned", figures.slices(trials, space)),
        ("Complete trials; dark lines are the good ones", figures.parallel(trials, space)),
        (_importance_caption(shares), bars),
    ]
    done = [trial for trial in trials if trial.state == TrialState.COMPLETE]
    return render_page(
        "nets.search",
        "report.html.j2",
        search=search,
        setting=_setting(search),
        budget=budget(study),
        names=keys(search.kind),
        best=sorted(done, key=lambda trial: (trial.value, trial.number))[:10],
        pictures=[(caption, base64.b64encode(png).decode()) for caption, png in pictures if png is not None],
        ranges=described_ranges(search.kind),
    )


def budget(study: optuna.Study) -> dict[str, str]:
    """What a search took, for people."""
    counts, trials = count(study), study.get_trials(deepcopy=False)
    spent = [trial.duration.total_seconds() for trial in trials if trial.duration is not None]
    starts = [trial.datetime_start for trial in trials if trial.datetime_start is not None]
    ends = [trial.datetime_complete for trial in trials if trial.datetime_complete is not None]
    from_first = (max(ends) - min(starts)).total_seconds() if starts and ends else 0.0
    workers = {trial.user_attrs["worker"] for trial in trials if "worker" in trial.user_attrs}
    too_large = sum(str(trial.user_attrs.get("reason", "")).startswith("too large") for trial in trials)
    return {
        "finished trials": str(counts.finished),
        "complete": str(counts.complete),
        "pruned": f"{counts.pruned}, {too_large} of them too large",
        "failed": f"{counts.failed}, besides {counts.retried} that were queued again",
        "epochs": str(sum(len(trial.intermediate_values) for trial in trials)),
        "time in trials": f"{sum(spent):.1f} s",
        "from first to last": f"{from_first:.1f} s",
        "workers": str(len(workers)),
    }


def _setting(search: SearchConfig) -> str:
    scene, training = search.run.scene, search.run.training
    samples = search.run.data or (
        f"{training.fixed_samples} simulated samples, the same for all trials"
        if training.fixed_samples
        else "fresh samples"
    )
    limit = "" if search.trial_time_s is None else f", {search.trial_time_s:g} s"
    return (
        f"Scene of {scene.height_samples}^2 heights and {scene.image_pixels}^2 pixels; {samples}; "
        f"{training.validation.count} validation samples; batches of {training.batch_size}; "
        f"up to {search.max_epochs} epochs of {training.steps_per_epoch} steps{limit} a trial; "
        f"sampler {search.sampler.upper()}, Hyperband from epoch 5 on; seed {training.seed}."
    )


def _importance_caption(shares: Mapping[str, float]) -> str:
    return "Importance: " + ", ".join(f"{name} {100 * share:.0f} %" for name, share in shares.items())


def _yaml(tree: Mapping[str, Any]) -> str:
    text: str = yaml.safe_dump(json.loads(json.dumps(tree)), sort_keys=False, width=120)
    return text


def _write(path: Path, text: str) -> None:
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
