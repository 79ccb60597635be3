"""All cells of a comparison: what is missing is computed, here or in several processes."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from data_gen.dataset_config import PhotonConfig
from nets.evaluation.cells import Bench, Cell, CellStore, Scoring, cell_key, image_scores
from nets.evaluation.fields import Field
from nets.evaluation.method_spec import MethodSpec
from nets.evaluation.processes import check_jobs, in_processes
from warp_caustics.device import start_device
from warp_caustics.scene import Scene

Report = Callable[[Cell, Mapping[str, Any]], None]
"""Called with every cell computed now, and its record."""


@dataclass(frozen=True)
class Setup:
    """What all cells share.

    Attributes:
        fields: the plates, by name.
        scene: the set-up.
        photons: of the images that methods get; scoring takes as many, on a lattice.
        device: where methods compute.
        store: where results go.
        scoring: makes what scores them.
    """

    fields: Mapping[str, Field]
    scene: Scene
    photons: PhotonConfig
    device: str
    store: CellStore
    scoring: Scoring = image_scores

    @property
    def n_photons(self) -> int:
        """Light paths per wavelength."""
        assert self.photons.n_photons is not None
        return self.photons.n_photons

    def bench(self) -> Bench:
        """Ready to compute."""
        return Bench(self.fields, self.scene, self.n_photons, self.device, self.store, self.scoring)

    def cells(self, specs: Sequence[MethodSpec], budgets: Sequence[str]) -> list[Cell]:
        """All cells, field by field, so that an early end leaves whole fields."""
        found = []
        for field in self.fields.values():
            content = field.content()
            for spec in specs:
                for budget in spec.budgets(budgets):
                    key = cell_key(spec, budget, content, self.scene, self.n_photons, self.device, self.scoring)
                    found.append(Cell(field.name, spec, budget, key))
        return found


def run_cells(
    setup: Setup,
    cells: Sequence[Cell],
    *,
    jobs: int = 1,
    gpus: Sequence[str] = (),
    force: bool = False,
    report: Report | None = None,
) -> list[dict[str, Any]]:
    """Records of all cells, in their order; only those not yet on disk are computed.

    Args:
        setup: what they share.
        cells: what to compute.
        jobs: processes; times of several at once are longer.
        gpus: that they take in turn (:func:`nets.evaluation.processes.gpus_for`).
        force: compute all anew.
        report: called after every cell computed.

    Raises:
        InputError: no such number of processes.
        ResourceError: a process was killed.
        KeyboardInterrupt: Ctrl-C; what is finished stays.
    """
    check_jobs(jobs)
    kept = {cell.key: None if force else setup.store.record(cell.key) for cell in cells}
    # Equal cells (nothing to limit, say) are computed once.
    missing = list({cell.key: cell for cell in cells if kept[cell.key] is None}.values())
    records = {key: record for key, record in kept.items() if record is not None}
    several = jobs > 1 and len(missing) > 1
    computed = (
        in_processes(missing, _work, partial(_start_worker, setup), jobs, gpus) if several else _here(setup, missing)
    )
    for cell, record in computed:
        records[cell.key] = record
        if report is not None:
            report(cell, record)
    names = ({"field": cell.field, "method": cell.spec.label, "budget": cell.budget} for cell in cells)
    return [records[cell.key] | name for cell, name in zip(cells, names, strict=True)]


def _here(setup: Setup, cells: Sequence[Cell]) -> Iterator[tuple[Cell, dict[str, Any]]]:
    bench = setup.bench() if cells else None
    for cell in cells:
        assert bench is not None
        yield cell, bench.run(cell)


_bench: Bench | None = None
"""Of a worker process."""


def _start_worker(setup: Setup) -> None:
    global _bench
    start_device(setup.device)
    _bench = setup.bench()


def _work(cell: Cell) -> dict[str, Any]:
    assert _bench is not None
    return _bench.run(cell)
