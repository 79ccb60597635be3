"""One cell of the comparison: a method, stopped after so many iterations, on a field. Kept on disk by content."""

import hashlib
import json
import time
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nets.evaluation.arrays import read_arrays, write_arrays
from nets.evaluation.code_version import code_version
from nets.evaluation.fields import Field
from nets.evaluation.meter import Meter
from nets.evaluation.method_spec import CONVERGED, ONCE, MethodSpec
from nets.evaluation.run import privileged_knowledge, reconstruct, warm_up
from nets.evaluation.scores import Scorer
from warp_caustics.errors import EXIT_BUG, CausticsError, ResourceError, is_out_of_memory
from warp_caustics.io.atomic import write_text
from warp_caustics.io.hashes import file_sha256
from warp_caustics.io.json_file import plain, write_json
from warp_caustics.io.regular import read_regular
from warp_caustics.reconstruct.base import Reconstruction
from warp_caustics.scene import Scene
from warp_caustics.simulator import usable_device
from warp_caustics.types import FloatArray

FORMAT = 1
"""Raised whenever cells of an earlier version of this package must not be used."""


Scoring = Callable[[Scene, int, str], Callable[[Reconstruction, Field], Mapping[str, Any]]]
"""Of scene, light paths and device: what scores a result of a field."""


def image_scores(scene: Scene, n_photons: int, device: str) -> Callable[[Reconstruction, Field], Mapping[str, Any]]:
    """Scores of ``nsfc compare``: see :class:`nets.evaluation.scores.Scorer`."""
    scorer = Scorer(scene, n_photons, device)
    return lambda result, field: scorer(result.heights_m, field)


@dataclass(frozen=True)
class Cell:
    """What is to be computed.

    Attributes:
        field: name of the field.
        spec: the method, not yet limited.
        budget: ``"10"``, ``"converged"`` or ``"once"``.
        key: hash of everything that decides the result.
    """

    field: str
    spec: MethodSpec
    budget: str
    key: str

    @property
    def title(self) -> str:
        """For progress lines."""
        counts = {CONVERGED: ", until it stops", ONCE: "", "1": ", 1 iteration"}
        return f"{self.field}, {self.spec.label}{counts.get(self.budget, f', {self.budget} iterations')}"


def cell_key(
    spec: MethodSpec,
    budget: str,
    content: Mapping[str, Any],
    scene: Scene,
    n_photons: int,
    device: str,
    scoring: Scoring = image_scores,
) -> str:
    """Hash of field, scene, method, settings, the files these name, code, the kind of device, and what is scored."""
    stages = [
        {"name": stage.name, "options": [[key, repr(value), _file_hash(value)] for key, value in stage.options]}
        for stage in spec.limited(budget).stages
    ]
    everything = {
        "format": FORMAT,
        "code": code_version(),
        "field": dict(content),
        "scene": scene.record(),
        "n_photons": n_photons,
        "stages": stages,
        # Methods choose image sizes by it, and times of different devices are no comparison.
        "device": usable_device(device).type,
    }
    if scoring is not image_scores:
        everything["scoring"] = scoring.__name__
    return hashlib.sha256(json.dumps(everything, sort_keys=True).encode()).hexdigest()[:32]


class CellStore:
    """Finished cells in a folder: ``KEY.json`` with scores, ``KEY.npz`` with the relief; the first exists last."""

    def __init__(self, folder: Path):
        self.folder = folder

    def record(self, key: str) -> dict[str, Any] | None:
        """Record of a finished cell; None if there is none, or what is there cannot be used."""
        try:
            record = json.loads(read_regular(self.folder / f"{key}.json"))
        except (OSError, ValueError):
            return None
        is_whole = isinstance(record, dict) and record.get("key") == key and "scores" in record
        return record if is_whole and self.heights(key) is not None else None

    def heights(self, key: str) -> FloatArray | None:
        """Recovered relief [m], float32, shape [n, n]; None if there is none."""
        arrays = read_arrays(self.folder / f"{key}.npz", ("heights_m",))
        return None if arrays is None else arrays["heights_m"]

    def write(self, key: str, record: Mapping[str, Any], result: Reconstruction) -> None:
        """Keep a finished cell."""
        arrays = {"heights_m": result.heights_m.astype(np.float32)}
        if result.uncertainty_m is not None:
            arrays["uncertainty_m"] = result.uncertainty_m.astype(np.float32)
        write_arrays(self.folder / f"{key}.npz", arrays)
        write_json(self.folder / f"{key}.json", record)

    def write_traceback(self, key: str, text: str) -> None:
        """Keep what a bug left behind; not taken for a result."""
        write_text(self.folder / f"{key}.traceback.txt", text)


class Bench:
    """Runs cells, one after the other.

    Args:
        fields: all of them.
        scene: the set-up.
        n_photons: light paths of images simulated for scoring.
        device: where methods compute.
        store: where results go.
        scoring: makes what scores them.
    """

    def __init__(
        self,
        fields: Mapping[str, Field],
        scene: Scene,
        n_photons: int,
        device: str,
        store: CellStore,
        scoring: Scoring = image_scores,
    ):
        self.fields, self.scene, self.device, self.store = fields, scene, device, store
        warm_up(scene, device)
        self.score = scoring(scene, n_photons, device)

    def run(self, cell: Cell) -> dict[str, Any]:
        """Compute and keep a cell. A method that fails gives a record that says why and is not kept.

        Raises:
            KeyboardInterrupt: Ctrl-C.
        """
        field = self.fields[cell.field]
        spec = cell.spec.limited(cell.budget)
        meter = Meter(usable_device(self.device))
        try:
            with meter:
                result = reconstruct(spec, field, self.scene, self.device)
            record = self._record(cell, field, result, meter)
            self.store.write(cell.key, record, result)
        except Exception as error:
            return self._failure(cell, error, meter)
        return record

    def _record(self, cell: Cell, field: Field, result: Reconstruction, meter: Meter) -> dict[str, Any]:
        record = {
            "key": cell.key,
            "field": cell.field,
            "method": cell.spec.label,
            "budget": cell.budget,
            "status": "done",
            "iterations": len(result.history),
            "scores": self.score(result, field),
            "time_s": meter.seconds,
            "peak_memory_MB": meter.peak_bytes / 1e6,
            "stop_reason": result.stop_reason,
            "residual": result.residual,
            "privileged": privileged_knowledge(result),
            "warnings": result.warnings,
            "timings_s": result.timings_s,
            "settings": result.settings,
            "counters": result.counters,
            "history": [_slim(entry) for entry in result.history],
            "device": self.device,
            "created": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        }
        tree: dict[str, Any] = plain(record)
        return tree

    def _failure(self, cell: Cell, error: Exception, meter: Meter) -> dict[str, Any]:
        reason, code = explained(error)
        if code == EXIT_BUG:
            self.store.write_traceback(cell.key, "".join(traceback.format_exception(error)))
        return {
            "key": cell.key,
            "field": cell.field,
            "method": cell.spec.label,
            "budget": cell.budget,
            "status": "failed",
            "reason": reason,
            "exit_code": code,
            "time_s": meter.seconds,
        }


def explained(error: Exception) -> tuple[str, int]:
    """One line and the exit code for what a method raised."""
    text = " ".join(str(error).split())[:300]
    if isinstance(error, CausticsError):
        return text, error.exit_code
    if is_out_of_memory(error):
        return "out of memory; use another device or a smaller scene", ResourceError.exit_code
    return f"unexpected {type(error).__name__}: {text}", EXIT_BUG


def _slim(entry: Mapping[str, Any]) -> dict[str, Any]:
    """What is worth keeping of an iteration."""
    return {name: entry[name] for name in ("stage", "iteration", "residual", "elapsed_s") if name in entry}


def _file_hash(value: Any) -> str | None:
    """Content of the file that a setting names, such as weights."""
    if not isinstance(value, str):
        return None
    path = Path(value)
    return file_sha256(path) if path.is_file() else None
