"""Methods on the cases of a suite, row by row; what a folder holds already is not computed again."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Any

from data_gen.dataset_config import PhotonConfig
from data_gen.suites.case import Case
from data_gen.suites.light import Light
from nets.evaluation.bench.fields import case_field
from nets.evaluation.bench.scores import bench_scores
from nets.evaluation.cells import Cell, CellStore
from nets.evaluation.fields import Field
from nets.evaluation.method_spec import CONVERGED, MethodSpec, Stage
from nets.evaluation.schedule import Report, Setup, run_cells
from warp_caustics.scene import Scene

COUNT_THE_BENCH, COUNTS_IT = ("auto", "direct", "fibres"), "bench_uncertainty"
"""Methods whose uncertainty has a part of the bench, and their option for it."""

FOLDERS = ("cells", "images")
"""Of a run: results, and images that methods got."""


def run_suite(
    cases: Sequence[Case],
    specs: Sequence[MethodSpec],
    folder: Path,
    device: str,
    *,
    n_photons: int | None = None,
    force: bool = False,
    report: Report | None = None,
    warn: Callable[[str], None] = lambda line: None,
) -> list[dict[str, Any]]:
    """Records of all cells, case by case: those of ``nets.evaluation.cells`` with ``row`` and ``title``.

    Args:
        cases: of a suite, rows together.
        specs: methods; each runs until it stops by itself.
        folder: exists; holds ``FOLDERS`` afterwards.
        device: where to simulate and reconstruct.
        n_photons: of images, in place of the suite's own; fewer to try.
        force: compute all cells anew; images stay.
        report: called after every cell computed.
        warn: called with what reading a photo had to say.

    Raises:
        KeyboardInterrupt: Ctrl-C; what is finished stays.
    """
    for name in FOLDERS:
        (folder / name).mkdir(exist_ok=True)
    light, records = Light(device, n_photons), []
    for _, row in groupby(cases, key=lambda case: case.row):
        of_row = list(row)
        fields = {case.name: case_field(case, light, folder / "images") for case in of_row}
        for field in fields.values():
            for line in field.warnings:
                warn(f"{field.name}: {line}")
        records += _row_records(of_row, fields, specs, folder, device, force, report)
    return records


def _row_records(
    cases: Sequence[Case],
    fields: Mapping[str, Field],
    specs: Sequence[MethodSpec],
    folder: Path,
    device: str,
    force: bool,
    report: Report | None,
) -> list[dict[str, Any]]:
    """Of cases whose methods are told the same scene."""
    (told,) = {case.told.model_dump_json(): case.told for case in cases}.values()
    setup = _setup(fields, told, folder, device)
    if all(case.is_bench_exact for case in cases):
        specs = [on_exact_bench(spec) for spec in specs]
    cells: list[Cell] = setup.cells(specs, (CONVERGED,))
    named = {case.name: {"row": case.row, "title": case.title} for case in cases}
    found = run_cells(setup, cells, force=force, report=report) if cells else []
    return [record | named[record["field"]] for record in found]


def on_exact_bench(spec: MethodSpec) -> MethodSpec:
    """The method told that its bench is exact: heights are the same, the uncertainty has no part of the bench.

    As a user who knows it says ``bench_uncertainty=false``; methods that do not count the bench are told nothing.
    """
    return replace(spec, stages=tuple(map(_exact, spec.stages)))


def _exact(stage: Stage) -> Stage:
    if stage.name not in COUNT_THE_BENCH or COUNTS_IT in dict(stage.options):
        return stage
    return Stage(stage.name, (*stage.options, (COUNTS_IT, False)))


def _setup(fields: Mapping[str, Field], told: Scene, folder: Path, device: str) -> Setup:
    # Scores need no simulation, so the number of light paths decides nothing.
    return Setup(fields, told, PhotonConfig(n_photons=1), device, CellStore(folder / "cells"), bench_scores)
