"""What no model knows: odd prints, benches, cameras and mistakes, and whether results say so where they are wrong.

    python -m benchmarks.beyond [--names groove hair ...] [--plates 0 1] [--device cuda] [--json FILE]
    python -m benchmarks.beyond --read FILE ...     # the table of docs/beyond.md

Plates are those of the row ``nothing`` of ``one-thing`` with a seed of their own; told is the default scene, and
nothing of what differs. Of each result: error, stated uncertainty, share within two of it, and what it says of itself.
Nothing was fitted to these images but the decision what to model next; thresholds were chosen with plate 0 in sight.
"""

import argparse
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.odd_light import LIGHT
from benchmarks.odd_reliefs import BENCHES, COLOURS, RELIEFS
from data_gen.suites.case import Case, Plate, bench_plates
from data_gen.suites.light import Light, true_heights
from data_gen.suites.one_thing import DIFFERENCES, one_case
from nets.evaluation.bench.detector import WRONG, is_wrong
from nets.reconstruct.methods import create
from warp_caustics.io.noise import estimate_noise_std
from warp_caustics.reconstruct.base import CausticImage, Reconstruction
from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray

SEED = 79_201
PLATES = 10
PHOTON_SEED = 5401
NOISE = 0.01
"""Relative to even light."""
LEAST_LIGHT = 0.5
"""Of a flat plate's light, below which a pixel is masked."""
UNTOLD = ("mirrored", "turned", "wedge", "lens", "big_bow", "astig_bow", "step_base")
"""What no image of one plate tells: which way round it lies, and heights that hardly bend light."""
NAMES = {**{name: each[0] for kind in (LIGHT, RELIEFS, BENCHES, COLOURS) for name, each in kind.items()}}
"""In words, by name."""


def plate_case(number: int) -> Case:
    """The plate on the bench that is told."""
    difference = DIFFERENCES["nothing"]
    return one_case("nothing", difference, Plate(bench_plates(SEED, PLATES, difference.reliefs), number))


def odd_image(case: Case, name: str, device: str, n_photons: int | None = None) -> tuple[CausticImage, FloatArray]:
    """The image of a case with one odd thing, and true heights [m], shape [n, n].

    Args:
        case: of :func:`plate_case`.
        name: of :data:`NAMES`.
        device: where to simulate.
        n_photons: per wavelength, in place of the case's own.
    """
    rng, light = np.random.default_rng([PHOTON_SEED, case.plate.number]), Light(device, n_photons)
    told, heights = case.told, true_heights(case)
    level = np.array(told.radiosity_W_m2, np.float32)[:, None, None]
    image: FloatArray
    mask = None
    if name in RELIEFS:
        heights = RELIEFS[name][1](heights, rng)
    if name in BENCHES:
        case = replace(case, scene=Scene.model_validate(told.model_dump() | BENCHES[name][1](told)))
    if name in COLOURS:
        shots = [light.behind_plate(_of_colours(case, moved), heights) for moved in COLOURS[name][1]]
        image = sum(shots[1:], shots[0]) / len(shots) / level
    else:
        image = light.behind_plate(case, heights) / level
    if name in BENCHES:
        flat = light.behind_flat(case) / level
        is_lit = flat >= LEAST_LIGHT
        image = np.where(is_lit, image / np.maximum(flat, LEAST_LIGHT), 1.0)
        mask = None if is_lit.all() else is_lit
    if name in LIGHT:
        image = LIGHT[name][1](image.astype(np.float64), rng)
    noisy = np.maximum(image + NOISE * case.plate.rng("noise").standard_normal(image.shape), 0)
    values = (noisy * level).astype(np.float32)
    valid = np.ones(values.shape, bool) if mask is None else mask
    noise = [
        estimate_noise_std(signal.astype(np.float64), bright, good)
        for signal, bright, good in zip(values, told.radiosity_W_m2, valid, strict=True)
    ]
    return CausticImage(values, np.array(noise) if np.isfinite(noise).all() else None, mask), heights


def _of_colours(case: Case, moved_m: FloatArray) -> Case:
    """The case lit by other wavelengths."""
    wavelengths = tuple((np.array(case.told.wavelengths_m) + moved_m).tolist())
    return replace(case, scene=Scene.model_validate(case.told.model_dump() | {"wavelengths_m": wavelengths}))


def figures(name: str, number: int, result: Reconstruction, truth_m: FloatArray) -> dict[str, Any]:
    """What is stored of a result."""
    error, stated = result.heights_m - truth_m, result.uncertainty_m
    known = stated is not None
    return {
        "name": name,
        "plate": number,
        "rmse_um": 1e6 * float(np.sqrt(np.mean(error**2))),
        "stated_um": 1e6 * float(np.sqrt(np.mean(np.square(stated, dtype=np.float64)))) if stated is not None else None,
        "within_two": float((np.abs(error) <= 2 * stated).mean()) if stated is not None else None,
        "doubted": bool(known and result.counters.get("doubt", {}).get("is_doubtful")),
        "warnings": len(result.warnings),
        "by": result.counters.get("explained_by", result.method),
    }


def table(rows: Iterable[Mapping[str, Any]]) -> list[str]:
    """Lines of the table in Markdown: a row for each odd thing, plates beside each other."""
    by_name: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        by_name.setdefault(row["name"], []).append(row)
    lines = ["| what is odd | error, stated [um] | within 2 u | wrong | warnings |", "|---" * 5 + "|"]
    for name in (name for name in NAMES if name in by_name):
        found = sorted(by_name[name], key=lambda row: row["plate"])
        pairs = "; ".join(f"{_um(row['rmse_um'])}, {_um(row['stated_um'])}" for row in found)
        within = "; ".join("-" if row["within_two"] is None else f"{100 * row['within_two']:.0f} %" for row in found)
        wrong = sum(is_row_wrong(row) for row in found)
        cells = [NAMES[name], pairs, within, str(wrong or ""), "; ".join(str(row["warnings"]) for row in found)]
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def is_row_wrong(row: Mapping[str, Any]) -> bool:
    """Whether a result is off by more than three times what it states; one that states nothing is not."""
    return row["stated_um"] is not None and is_wrong(row["rmse_um"], row["stated_um"])


def summary(rows: Sequence[Mapping[str, Any]]) -> str:
    """How many are wrong, of those that an image could tell."""
    told = [row for row in rows if row["name"] not in UNTOLD]
    wrong = [row for row in told if is_row_wrong(row)]
    return (
        f"{len(wrong)} of {len(told)} results are off by more than {WRONG:g} times what they state "
        f"({', '.join(sorted({row['name'] for row in wrong})) or 'none'}), beside {len(rows) - len(told)} of what no "
        "image tells"
    )


def _um(value: float | None) -> str:
    return "-" if value is None else f"{value:.2g}" if value < 10 else f"{value:.0f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--names", nargs="+", default=list(NAMES), choices=list(NAMES), metavar="NAME")
    parser.add_argument("--plates", nargs="+", type=int, default=[0], choices=range(PLATES), metavar="NUMBER")
    parser.add_argument("--method", default="fibres", choices=("direct", "fibres", "auto"))
    parser.add_argument("--set-up", default="estimate", choices=("known", "estimate"), help="what a GPU does")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--read", type=Path, nargs="+", help="figures of earlier runs, to be made a table")
    arguments = parser.parse_args()
    if arguments.read:
        rows = [row for file in arguments.read for row in json.loads(file.read_text())["rows"]]
        print("\n".join([*table(rows), summary(rows)]))
        return
    rows, method = [], create(arguments.method, Scene(), device=arguments.device, set_up=arguments.set_up)
    for number in arguments.plates:
        for name in arguments.names:
            image, truth = odd_image(plate_case(number), name, arguments.device)
            rows.append(figures(name, number, method.reconstruct(image), truth))
            print(json.dumps(rows[-1]), flush=True)
            if arguments.json:
                told = {"method": arguments.method, "seed": SEED, "device": arguments.device}
                arguments.json.write_text(json.dumps(told | {"rows": rows}, indent=1) + "\n")
    print("\n".join([*table(rows), summary(rows)]))


if __name__ == "__main__":
    main()
