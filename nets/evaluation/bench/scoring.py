"""Scores of heights that another program made for the cases of a suite."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from data_gen.suites.case import Case
from data_gen.suites.light import true_heights
from nets.evaluation.bench.scores import relief_scores
from warp_caustics.errors import InputError, MismatchError
from warp_caustics.io.heights import read_heights
from warp_caustics.types import FloatArray

SUFFIXES = (".npy", ".npz", ".tif", ".tiff", ".h5")


def score_folder(folder: Path, cases: Sequence[Case], method: str) -> tuple[list[dict[str, Any]], list[str]]:
    """Scores of a folder's height maps, as records of cells.

    Heights of a case are ``CASE.npy`` (or another of ``SUFFIXES``), or ``CASE/height.npy`` as ``nsfc reconstruct``
    writes it; an uncertainty is ``CASE_uncertainty.npy`` or ``CASE/uncertainty.npy``. All files are checked before
    anything is scored.

    Args:
        folder: with the files.
        cases: of a suite.
        method: name of what made them.

    Returns:
        Records, and lines about cases that are missing.

    Raises:
        InputError: no such folder, nothing for any case, two files for one, or a file that holds no heights.
        MismatchError: another number of samples.
    """
    if not folder.is_dir():
        raise InputError(f"{str(folder)!r} is no folder; give one with files such as {cases[0].name}.npy")
    found = {case.name: _read(folder, case, "", "height") for case in cases}
    missing = [name for name, heights in found.items() if heights is None]
    if len(missing) == len(cases):
        raise InputError(
            f"{str(folder)!r} holds heights of no case of suite {cases[0].suite}; name files as {cases[0].name}.npy"
        )
    uncertain = {case.name: _read(folder, case, "_uncertainty", "uncertainty") for case in cases}
    records = []
    for case in cases:
        heights, uncertainty = found[case.name], uncertain[case.name]
        record: dict[str, Any] = {"field": case.name, "row": case.row, "title": case.title, "method": method}
        if heights is None:
            records.append(record | {"status": "failed", "reason": "no heights"})
            continue
        scores = relief_scores(heights, true_heights(case), case.told, uncertainty)
        records.append(record | {"status": "done", "scores": scores})
    listed = ", ".join(missing[:5]) + ", ..." * (len(missing) > 5)
    return records, [f"{len(missing)} of {len(cases)} cases have no heights: {listed}"] if missing else []


def _read(folder: Path, case: Case, ending: str, inside: str) -> FloatArray | None:
    """A map of a case [m], shape [n, n]; None if there is none."""
    places = [folder / f"{case.name}{ending}{suffix}" for suffix in SUFFIXES]
    places += [folder / case.name / f"{inside}.npy"]
    there = [path for path in places if path.exists()]
    if len(there) > 1:
        raise InputError(f"{there[0].name!r} and {str(there[1].name)!r} are both of case {case.name}; leave one")
    if not there:
        return None
    samples = case.told.height_samples

    def fits(count: int) -> None:
        if count != samples:
            raise MismatchError(
                f"{str(there[0])!r} has {count} x {count} samples, the truth {samples} x {samples}; resample it to "
                "the centres of as many cells"
            )

    return read_heights(there[0], fits=fits)
