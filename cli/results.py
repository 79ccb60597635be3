"""What a reconstruction leaves in its folder: record, heights, pictures and report."""

import os
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cli.config import Config, dump_config
from cli.garbage import postponed
from cli.inputs import Inputs
from cli.output import ResultKind, write_print
from cli.provenance import provenance
from cli.report.content import ReportContent
from warp_caustics.io.atomic import atomic_path, write_text
from warp_caustics.io.heights import write_heights
from warp_caustics.io.json_file import write_json
from warp_caustics.io.printable import printable
from warp_caustics.metrics import height_errors
from warp_caustics.prints.design_writer import write_paths
from warp_caustics.prints.line import Line
from warp_caustics.prints.line_list import write_lines

if TYPE_CHECKING:
    from warp_caustics.inspection.findings import Inspection
    from warp_caustics.reconstruct.base import Reconstruction
    from warp_caustics.types import FloatArray

FILES = (
    "height.npy", "height.tif", "surface.stl", "result.json", "overview.png", "report.html", "config.resolved.yaml",
)  # fmt: skip
"""What a result folder holds."""

UNCERTAINTY_FILES = ("uncertainty.npy", "uncertainty.tif", "uncertainty.png")
"""What it holds besides where the method knows how uncertain its heights are; --force replaces both, nothing else."""

FIBRE_FILES, PATH_FILES = ("printed_lines.csv",), ("printed_lines.yaml",)
"""What it holds besides where the method found the lines that were printed: straight, or with corners and curves."""

SAMPLE_FILES = ("samples.npy",)
"""What it holds besides where samples were asked for: of what the image leaves open, shape [N, n, n] [m], float32."""

ALL_FILES = (*FILES, *UNCERTAINTY_FILES, *FIBRE_FILES, *PATH_FILES, *SAMPLE_FILES)
LEAST_UNEVEN = 2e-3
"""Of light over a picture, from which on people are told."""
RECONSTRUCTION = ResultKind("reconstruction", ALL_FILES)


def result_record(result: "Reconstruction", inputs: Inputs, config: Config) -> dict[str, Any]:
    """Everything about a result but its arrays."""
    reference, plate = inputs.reference, config.scene.plate_size_m
    return {
        "trust": None if result.trust is None else asdict(result.trust),
        "method": result.method,
        "residual": result.residual,
        "stop_reason": result.stop_reason,
        "iterations": len(result.history),
        "errors": None if reference is None else height_errors(result.heights_m, reference, plate),
        "initial_errors": None
        if reference is None or inputs.initial is None
        else height_errors(inputs.initial, reference, plate),
        "uncertainty": uncertainty_record(result, reference),
        "no_uncertainty": result.no_uncertainty or None,
        "height_range_m": [result.heights_m.min(), result.heights_m.max()],
        "timings_s": result.timings_s,
        "counters": result.counters,
        "settings": result.settings,
        "warnings": [*inputs.capture.warnings, *result.warnings],
        "inputs": inputs.files,
        "calibration": {
            "steps": inputs.capture.steps,
            "noise_std_W_m2": inputs.capture.noise_std,
            "saturated_fraction": inputs.capture.saturated_fraction,
        },
        **provenance(config),
        "history": result.history,
    }


def uncertainty_record(result: "Reconstruction", reference: "FloatArray | None") -> dict[str, Any] | None:
    """Figures of the uncertainty [um], its parts, and what share of errors it covers where the truth is known."""
    if result.uncertainty_m is None:
        return None
    sigma = result.uncertainty_m
    record = {
        "rms_um": float(np.sqrt(np.mean(sigma**2))) * 1e6,
        "quantile95_um": float(np.quantile(sigma, 0.95)) * 1e6,
    }
    parts = result.counters.get("uncertainty")
    if parts is not None:
        record["parts"] = parts
    if reference is not None:
        error = np.abs(result.heights_m - reference)
        record |= {"within_one": float((error <= sigma).mean()), "within_two": float((error <= 2 * sigma).mean())}
    return record


@postponed()
def write_results(
    folder: Path,
    result: "Reconstruction",
    inputs: Inputs,
    config: Config,
    record: Mapping[str, Any],
    inspection: "Inspection | None" = None,
) -> None:
    """Write the files of a result (``cli.results.FILES``) into a folder."""
    from cli.figures import write_figure
    from cli.overview import overview_figure, uncertainty_figure
    from cli.report.write import write_report

    scene = config.scene
    if result.uncertainty_m is not None:
        write_heights(folder / "uncertainty.npy", result.uncertainty_m)
        write_heights(folder / "uncertainty.tif", result.uncertainty_m)
        write_figure(folder / "uncertainty.png", uncertainty_figure(scene, result.uncertainty_m))
    if result.fibres_m is not None:
        write_lines(folder / "printed_lines.csv", [Line((a, b), (c, d), w, h) for a, b, c, d, w, h in result.fibres_m])
    if result.paths is not None:
        write_paths(folder / PATH_FILES[0], result.paths)
    if result.samples_m is not None:
        with atomic_path(folder / SAMPLE_FILES[0]) as temporary:
            np.save(temporary, result.samples_m.astype(np.float32), allow_pickle=False)
    write_print(folder, result.heights_m, scene)
    figure = overview_figure(
        scene=scene,
        measured=inputs.capture.irradiance,
        simulated=result.picture,
        heights_m=result.heights_m,
        caption=f"{result.method}: {'; '.join(_figures(result, record))}",
    )
    write_figure(folder / "overview.png", figure)
    content = ReportContent(
        title=printable(os.path.basename(inputs.files["image"]["path"])),
        scene=scene,
        record=record,
        measured=inputs.capture.irradiance,
        simulated=result.picture,
        heights_m=result.heights_m,
        uncertainty_m=result.uncertainty_m,
        reference_m=inputs.reference,
        samples_m=result.samples_m,
        stages=inputs.capture.stages,
        inspection=inspection,
        mask=inputs.capture.mask,
    )
    write_report(folder / "report.html", content)
    write_text(folder / "config.resolved.yaml", dump_config(config))
    write_json(folder / "result.json", record)


def _figures(result: "Reconstruction", record: Mapping[str, Any]) -> list[str]:
    figures = [f"image residual {result.residual:.3g}"]
    if record["errors"]:
        errors = record["errors"]
        figures.append(f"height RMSE {errors['rmse_um']:.3g} um (flat guess {errors['reference_rms_um']:.3g} um)")
    return figures


def trust_lines(record: Mapping[str, Any]) -> list[str]:
    """How far a result is to be believed: the first line of every summary; none for a result that was not asked."""
    return [f"trust      {record['trust']['line']}"] if record.get("trust") else []


def rest_lines(record: Mapping[str, Any]) -> list[str]:
    """What the rest of the image looks like, and what of the camera is in the model; nothing where neither is known."""
    counters = record.get("counters") or {}
    lines = [f"rest       {counters['rest']['line']}"] if counters.get("rest") else []
    camera = counters.get("camera") or {}
    apart = max((abs(value) for shift in camera.get("shift_px", []) for value in shift), default=0.0)
    blur = max(camera.get("blur_px", []), default=0.0)
    lens = " by its point spread" if "spread" in camera else ""
    found = [f"channels {apart:.2g} px apart"] * (apart > 0) + [f"blur of {blur:.2g} px{lens}"] * (blur > 0)
    if "mosaic" in counters:
        found.append(f"colour filters {counters['mosaic']}, pixels made up between them")
    return [*lines, *([f"camera     {', '.join(found)}: in the model"] if found else [])]


def made_words(record: Mapping[str, Any]) -> str:
    """How lines are made beside their section: caps, cut bells, thicker ends, waves; each with a comma before it."""
    counters = record.get("counters") or {}
    section, waves, words = counters.get("section") or {}, counters.get("waves"), []
    if section.get("is_cap"):
        words.append("circular caps")
    if section.get("cut", 0.0) > 0:
        words.append(f"cut off at {100 * section['cut']:.2g} % of their crown")
    if section.get("thicker", 0.0) > 0:
        words.append(f"{100 * section['thicker']:.2g} % thicker at their ends")
    if waves:
        varies = f"{100 * waves['thickness']:.2g} % thicker and thinner and {1e6 * waves['aside_m']:.2g} um aside"
        words.append(f"{varies} along their way (root mean squares)")
    return "".join(f", {word}" for word in words)


def care_lines(record: Mapping[str, Any]) -> list[str]:
    """How much less well a bench is taken as known than of a careful user; none where that is hardly so."""
    line = ((record.get("counters") or {}).get("uncertainty") or {}).get("care", {}).get("line")
    return [f"care       {line}"] if line else []


def found_bench_lines(result: "Reconstruction") -> list[str]:
    """What the image told of its bench, a line for each number; none where it was not looked for."""
    from warp_caustics.found_bench.bench_record import NOT_TOLD

    found = result.counters.get("bench")
    if not found:
        return []
    untold = [number["name"] for number in found["numbers"] if number["verdict"] == NOT_TOLD]
    lines = [_number_line(number) for number in found["numbers"] if number["verdict"] != NOT_TOLD]
    if found.get("uneven", 0.0) >= LEAST_UNEVEN:
        lines.append(f"bench      light uneven by {100 * found['uneven']:.2g} % over the picture, found with the lines")
    return [*lines, *([f"bench      {NOT_TOLD}: {', '.join(untold)}"] if untold else [])]


def _number_line(number: Mapping[str, Any]) -> str:
    """What is used, and what the image says where that is another value."""
    from warp_caustics.found_bench.bench_record import in_brackets

    unit = "" if number["unit"] == "1" else f" {number['unit']}"
    verdict = {
        "found": f"told {number['told']:.4g}",
        "in doubt": f"as told, in doubt: the image looks as of {number['seen'] or 0:.4g}",
    }.get(number["verdict"], number["verdict"])
    value = f"{number['found']:.4g} +- {number['sigma']:.2g}{unit}"
    return f"bench      {number['name']} {value}, {verdict}{in_brackets(number['why'])}"


def _parts(parts: Mapping[str, Any] | None) -> str:
    """Of what the uncertainty is made, and which of the bench's numbers makes most of that; empty where unknown."""
    if not parts or not parts["numbers"]:
        return ""
    name, most = next(iter(parts["numbers"].items()))
    return (
        f"; the image leaves {parts['network_um']:.3g} um, the bench {parts['bench_um']:.3g} um, most by "
        f"{name} +- {most['sigma']:.2g}"
    )


def _at_all(result: "Reconstruction") -> str:
    """Where the residual is of other pixels than the share of the line ``trust``, and what noise leaves of those."""
    if result.trust is None or result.trust.pixels is None:
        return ""
    floor = result.trust.floor_at_all
    of_noise = "" if floor is None else f", where noise and simulation leave {floor:.2g}"
    return f" at all {result.image.shape[-1]} pixels{of_noise}"


def summary(output: str, result: "Reconstruction", record: Mapping[str, Any]) -> list[str]:
    """A few lines for people."""
    files = FILES if result.uncertainty_m is None else (*FILES, *UNCERTAINTY_FILES)
    if result.fibres_m is not None:
        files = (*files, *FIBRE_FILES)
    if result.paths is not None:
        files = (*files, *PATH_FILES)
    if result.samples_m is not None:
        files = (*files, *SAMPLE_FILES)
    low, high = (height * 1e3 for height in record["height_range_m"])
    lines = [
        *trust_lines(record),
        *rest_lines(record),
        f"result     {output}: {', '.join(files)}",
        f"method     {result.method}, {len(result.history)} iterations, {sum(result.timings_s.values()):.1f} s, "
        f"stopped by {result.stop_reason.replace('_', ' ')}",
        f"residual   {result.residual:.4g} of the image{_at_all(result)}",
        f"heights    {low:.4g} to {high:.4g} mm",
    ]
    lines += found_bench_lines(result)
    if result.fibres_m is not None:
        lines.append(f"lines      {len(result.fibres_m)} printed lines{made_words(record)}, in {FIBRE_FILES[0]}")
    if result.paths is not None:
        told = f"{len(result.paths)} printed lines with corners and curves{made_words(record)}"
        lines.append(f"lines      {told}, in {PATH_FILES[0]}")
    errors = record["errors"]
    if errors:
        lines.append(
            f"errors     RMSE {errors['rmse_um']:.4g} um (without the mean {errors['rmse_mean_removed_um']:.4g}), "
            f"95 % within {errors['quantile95_um']:.4g} um; a flat guess has {errors['reference_rms_um']:.4g} um"
        )
    if record["uncertainty"]:
        found = record["uncertainty"]
        lines.append(
            f"uncertain  {found['rms_um']:.3g} um (root mean square), 95 % of the plate below "
            f"{found['quantile95_um']:.3g} um{_parts(found.get('parts'))}"
        )
        lines += care_lines(record)
    elif record["no_uncertainty"]:
        lines.append(f"uncertain  none, because {record['no_uncertainty']}")
    if result.counters.get("samples"):
        lines.append(f"samples    {result.counters['samples']['line']}")
    if record["initial_errors"]:
        lines.append(f"start      RMSE {record['initial_errors']['rmse_um']:.4g} um")
    return lines
