"""What was run on which cases, and with what."""

from collections.abc import Sequence
from typing import Any

from cli.provenance import now, versions
from data_gen.suites.case import Case
from nets.evaluation.bench.runs import Run
from nets.evaluation.code_version import code_version
from warp_caustics.device import device_name


def about_scores(cases: Sequence[Case], method: str) -> dict[str, Any]:
    """Of heights that another program made."""
    return {
        "suite": cases[0].suite,
        "methods": [method],
        "cases": [case.name for case in cases],
        "device": None,
        "n_photons": None,
        "seed": None,
        "jobs": 1,
        "versions": versions(),
        "code": code_version(),
        "created": now(),
    }


def about_run(cases: Sequence[Case], run: Run, seed: int | None) -> dict[str, Any]:
    """Of a run; its number of light paths is None where images have the suite's own, its seed where plates are."""
    return about_scores(cases, "") | {
        "methods": [spec.label for spec in run.specs],
        "device": device_name(run.device),
        "n_photons": run.n_photons,
        "seed": seed,
        "jobs": run.jobs,
    }
