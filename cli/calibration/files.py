"""What a calibration leaves in its folder: bench.yaml, record, picture and page."""

import base64
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from cli.calibration.picture import residual_figure
from cli.figures import write_figure
from cli.output import ResultKind
from cli.provenance import now, versions
from warp_caustics.calibration.advice import Advice, LeastTold
from warp_caustics.calibration.bench_file import VERSION, Bench, BenchParameter, scene_tree, write_bench
from warp_caustics.calibration.found import TOLD, Calibration, Found
from warp_caustics.io.atomic import write_text
from warp_caustics.io.json_file import write_json
from warp_caustics.io.page import render_page
from warp_caustics.io.regular import read_regular

BENCH, PAGE, RECORD, PICTURE = "bench.yaml", "report.html", "result.json", "residuals.png"
CALIBRATION = ResultKind("calibration", (BENCH, PAGE, RECORD, PICTURE))
SHOWN_UNITS = {"m": (1e6, "um"), "rad": (1e3, "mrad")}
"""Factor and unit for people; others are shown as they are."""
STRONGEST = 0.7
"""Correlation from which pairs are named."""
MOST_PAIRS = 40

MAX_PICTURE_BYTES = 64_000_000
"""Of the picture that was just drawn."""


def bench_of(found: Calibration, inputs: Mapping[str, Any]) -> Bench:
    """The bench as it is written."""
    return Bench(
        nsfc_bench=VERSION,
        scene=scene_tree(found.scene),
        camera=found.camera,
        parameters=tuple(
            BenchParameter(
                name=f.parameter.name, unit=f.parameter.unit, value=f.value, sigma=f.sigma, before=f.before,
                prior=f.parameter.prior, verdict=f.verdict,
            )
            for f in found.bench
        ),
        covariance=tuple(tuple(row) for row in found.covariance.tolist()),
        provenance={"created": now(), "versions": versions(), "inputs": dict(inputs)},
    )  # fmt: skip


def write_calibration(
    folder: Path, found: Calibration, told: tuple[LeastTold, Sequence[Advice]], record: Mapping[str, Any]
) -> None:
    """Write all files of a result."""
    write_bench(folder / BENCH, bench_of(found, record["inputs"]))
    write_json(folder / RECORD, record)
    write_figure(folder / PICTURE, residual_figure(found))
    picture = base64.b64encode(read_regular(folder / PICTURE, MAX_PICTURE_BYTES)).decode("ascii")
    least, advised = told
    text = render_page(
        "cli.calibration",
        "page.html.j2",
        views=[
            {
                "name": fit.view.name,
                "plate": fit.view.plate.name,
                "is_divided": fit.view.is_divided,
                "misfit": ", ".join(f"{value:.2f}" for value in fit.misfit),
                "explained": f"{fit.explained:.1%}",
            }
            for fit in found.fits
        ],
        warnings=list(record["warnings"]),
        told=TOLD,
        lines=[shown(f) for f in found.bench],
        own=[shown(f) | {"view": f.view} for f in found.found if f.view is not None],
        strongest=STRONGEST,
        least=least_words(least),
        pairs=strong_pairs(found),
        advice=[
            {"what": item.what, "left": item.left, "most": item.most, "sigma": _sigma(found, item)} for item in advised
        ],
        picture=f"data:image/png;base64,{picture}",
        versions=versions(),
        created=now(),
    )
    write_text(folder / PAGE, text)


def shown(item: Found) -> dict[str, str]:
    """A number for people, in units that they use."""
    factor, unit = SHOWN_UNITS.get(item.parameter.unit, (1.0, item.parameter.unit))
    digits = _digits(item.sigma * factor)
    return {
        "name": item.parameter.name,
        "unit": unit,
        "before": f"{item.before * factor:.6g}",
        "prior": f"{item.parameter.prior * factor:.3g}",
        "value": f"{item.value * factor:.{digits}f}",
        "sigma": f"{item.sigma * factor:.2g}",
        "noise": f"{item.noise_sigma * factor:.2g}",
        "left": f"{item.remaining:.0%}",
        "verdict": item.verdict,
        "meaning": item.parameter.meaning,
    }


def _digits(sigma: float) -> int:
    """Decimals that a value deserves: two digits of its deviation."""
    places = 0
    while sigma > 0 and sigma * 10**places < 9.5 and places < 9:
        places += 1
    return places


def least_words(least: LeastTold) -> str:
    """The least told combination in one line."""
    parts = " ".join(f"{'+' if weight > 0 else '-'} {name}" for name, weight in least.parts)
    return f"{parts.removeprefix('+ ')}, of which {least.remaining:.0%} of what was unknown is left"


def strong_pairs(found: Calibration) -> list[tuple[str, str, float]]:
    """Pairs of numbers whose errors go together, strongest first."""
    names, matrix = found.setup.names, found.correlations
    pairs = [
        (names[i], names[j], float(matrix[i, j]))
        for i in range(len(names))
        for j in range(i)
        if abs(float(matrix[i, j])) >= STRONGEST
    ]
    return sorted(pairs, key=lambda pair: -abs(pair[2]))[:MOST_PAIRS]


def _sigma(found: Calibration, item: Advice) -> str:
    unit = next(f.parameter.unit for f in found.bench if f.parameter.name == item.most)
    factor, shown_unit = SHOWN_UNITS.get(unit, (1.0, unit))
    return f"{item.sigma * factor:.2g} {shown_unit}"
