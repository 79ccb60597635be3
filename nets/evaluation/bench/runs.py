"""Methods on the cases of a suite, row by row or in several processes; what a folder holds is not computed again."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
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
from nets.evaluation.processes import check_jobs, in_processes
from nets.evaluation.schedule import Report, Setup, run_cells
from warp_caustics.device import start_device
from warp_caustics.scene import Scene

COUNT_THE_BENCH, COUNTS_IT = ("auto", "direct", "fibres"), "bench_uncertainty"
"""Methods whose uncertainty has a part of the bench, and their option for it."""

FOLDERS = ("cells", "images")
"""Of a run: results, and images that methods got."""


@dataclass(frozen=True)
class Run:
    """What all cases of a run share.

    Attributes:
        specs: methods; each runs until it stops by itself.
        folder: exists; holds ``FOLDERS`` afterwards.
        device: where to simulate and reconstruct.
        n_photons: of images, in place of the suite's own; fewer to try.
        force: compute all cells anew; images stay.
        jobs: processes, a case at a time each; times of several at once are longer.
        gpus: that they take in turn (:func:`nets.evaluation.processes.gpus_for`).
    """

    specs: Sequence[MethodSpec]
    folder: Path
    device: str
    n_photons: int | None = None
    force: bool = False
    jobs: int = 1
    gpus: Sequence[str] = ()

    def light(self) -> Light:
        """What simulates images."""
        return Light(self.device, self.n_photons)


@dataclass(frozen=True)
class CaseRecords:
    """What came of the cases of one row.

    Attributes:
        records: of all their cells.
        computed: those of them that were not kept before, with their cells.
        warnings: what reading photos had to say.
    """

    records: list[dict[str, Any]]
    computed: list[tuple[Cell, Mapping[str, Any]]]
    warnings: list[str]


def run_suite(
    cases: Sequence[Case],
    run: Run,
    *,
    report: Report | None = None,
    warn: Callable[[str], None] = lambda line: None,
) -> list[dict[str, Any]]:
    """Records of all cells, case by case: those of ``nets.evaluation.cells`` with ``row`` and ``title``.

    Args:
        cases: of a suite, rows together.
        run: what they share.
        report: called after every cell computed.
        warn: called with what reading a photo had to say.

    Raises:
        InputError: no such number of processes.
        ResourceError: a process was killed.
        KeyboardInterrupt: Ctrl-C; what is finished stays.
    """
    check_jobs(run.jobs)
    for name in FOLDERS:
        (run.folder / name).mkdir(exist_ok=True)
    if run.jobs > 1 and len(cases) > 1:
        found: dict[str, list[dict[str, Any]]] = {}
        for case, done in in_processes(cases, _work, partial(_start_worker, run), run.jobs, run.gpus):
            found[case.name] = done.records
            _tell(done, report, warn)
        return [record for case in cases for record in found[case.name]]
    light, records = run.light(), []
    for _, row in groupby(cases, key=lambda case: case.row):
        done = _row_records(list(row), run, light, report)
        _tell(done, None, warn)
        records += done.records
    return records


def _tell(done: CaseRecords, report: Report | None, warn: Callable[[str], None]) -> None:
    for line in done.warnings:
        warn(line)
    if report is not None:
        for cell, record in done.computed:
            report(cell, record)


_worker: tuple[Run, Light] | None = None
"""Of a process: what it was started for."""


def _start_worker(run: Run) -> None:
    global _worker
    start_device(run.device)
    _worker = run, run.light()


def _work(case: Case) -> CaseRecords:
    assert _worker is not None
    return _row_records([case], *_worker, None)


def _row_records(cases: Sequence[Case], run: Run, light: Light, report: Report | None) -> CaseRecords:
    """Of cases whose methods are told the same scene."""
    fields = {case.name: case_field(case, light, run.folder / "images") for case in cases}
    (told,) = {case.told.model_dump_json(): case.told for case in cases}.values()
    setup = _setup(fields, told, run.folder, run.device)
    is_exact = all(case.is_bench_exact for case in cases)
    cells = setup.cells([on_exact_bench(spec) for spec in run.specs] if is_exact else run.specs, (CONVERGED,))
    computed: list[tuple[Cell, Mapping[str, Any]]] = []

    def done(cell: Cell, record: Mapping[str, Any]) -> None:
        computed.append((cell, record))
        if report is not None:
            report(cell, record)

    found = run_cells(setup, cells, force=run.force, report=done) if cells else []
    named = {case.name: {"row": case.row, "title": case.title} for case in cases}
    lines = [f"{field.name}: {line}" for field in fields.values() for line in field.warnings]
    return CaseRecords([record | named[record["field"]] for record in found], computed, lines)


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
