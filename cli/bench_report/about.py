"""What was run on which cases, and with what."""

from collections.abc import Sequence
from typing import Any

from cli.provenance import now, versions
from data_gen.suites.case import Case
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
        "versions": versions(),
        "code": code_version(),
        "created": now(),
    }


def about_run(cases: Sequence[Case], methods: Sequence[str], device: str, n_photons: int | None) -> dict[str, Any]:
    """Of a run; ``n_photons`` is None where images have the suite's own number of light paths."""
    own = {"methods": list(methods), "device": device_name(device), "n_photons": n_photons}
    return about_scores(cases, "") | own
