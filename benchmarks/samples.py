"""Is the truth nearer to one of the samples than to the result, where they differ? ``direct`` with five samples.

    python -m benchmarks.samples [--seed 4771001] [--device cpu] [--json FILE] [--rows ROW:COUNT ...]
    python -m benchmarks.samples --read FILE

Plates as of ``benchmarks/trusted.py``, of a seed of their own. A region is a connected part of the plate where samples
differ by more than 5 um; there the RMS error of the result is compared with that of the nearest sample. ``between`` is
the share of differing points whose truth lies between the lowest and the highest sample, 2 um more allowed.
"""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import scipy.ndimage

from benchmarks.trusted import plates
from nets.reconstruct.methods import create
from nets.reconstruct.posterior_samples import DIFFERENT_M, MOST_SAMPLES, SMALLEST_PART
from warp_caustics.reconstruct.base import Reconstruction
from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray

SEED = 4_771_001
ROWS = ("nothing:2", "careful:2", "ordinary:2", "ellipse:1", "apart-0.3:1")
ALLOWED_M = 2e-6


def measured_row(row: str, number: int, result: Reconstruction, truth: FloatArray) -> dict[str, Any]:
    """Figures of one plate."""
    samples, sigma = result.samples_m, result.uncertainty_m
    assert samples is not None and sigma is not None
    error = result.heights_m - truth
    apart = samples.std(axis=0, ddof=1)
    where = apart > DIFFERENT_M
    labels, count = scipy.ndimage.label(scipy.ndimage.binary_dilation(where))
    regions = [labels == k for k in range(1, count + 1) if (where & (labels == k)).sum() >= SMALLEST_PART]
    nearer = sum(
        float(np.square(samples - truth)[:, region].mean(axis=1).min()) < float(np.square(error[region]).mean())
        for region in regions
    )
    between = (samples.min(axis=0) - ALLOWED_M <= truth) & (truth <= samples.max(axis=0) + ALLOWED_M)
    told = result.counters["samples"]
    return {
        "row": row,
        "plate": number,
        "rmse_um": 1e6 * float(np.sqrt(np.mean(error**2))),
        "of_samples_um": (1e6 * np.sqrt(np.square(samples - truth).mean(axis=(1, 2)))).tolist(),
        "differ_um": told["differ_um"],
        "share": told["share"],
        "error_there": float(np.square(error[where]).sum() / np.square(error).sum()),
        "regions": len(regions),
        "nearer": nearer,
        "between": float(between[where].mean()) if where.any() else None,
        "within": [float((np.abs(error) <= k * sigma)[where].mean()) for k in (1, 2)] if where.any() else None,
        "samples_within_two": told["within_two"],
        "residual": told["residual"],
        "residuals": told["residuals"],
        "seconds": result.timings_s["samples"],
    }


def summary(rows: Sequence[dict[str, Any]]) -> list[str]:
    """One line for each plate, and what all of them say."""
    lines = [
        "row          RMSE [um]  differ [um] on   of the error  regions, nearer  between  within 1, 2 u  residuals"
    ]
    for row in rows:
        within = "-" if row["within"] is None else ", ".join(f"{100 * each:.0f}" for each in row["within"])
        between = "-" if row["between"] is None else f"{100 * row['between']:.0f} %"
        ratios = np.array(row["residuals"]) / row["residual"]
        lines.append(
            f"{row['row']:<12}{row['rmse_um']:>8.1f}{row['differ_um']:>12.1f}{100 * row['share']:>6.1f} %"
            f"{100 * row['error_there']:>11.0f} %{row['regions']:>8}, {row['nearer']:<6}{between:>9}{within:>14} %"
            f"   {ratios.min():.2f} to {ratios.max():.2f}"
        )
    regions, nearer = (sum(row[key] for row in rows) for key in ("regions", "nearer"))
    lines.append(f"regions where a sample is nearer to the truth than the result: {nearer} of {regions}")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--rows", nargs="+", default=list(ROWS))
    parser.add_argument("--read", type=Path, help="only sum up a file")
    arguments = parser.parse_args()
    if arguments.read:
        print("\n".join(summary(json.loads(arguments.read.read_text())["plates"])))
        return
    method = create("direct", Scene(), device=arguments.device, set_up="known", samples=MOST_SAMPLES)
    rows: list[dict[str, Any]] = []
    for row, count in ((name, int(count)) for name, count in (each.split(":") for each in arguments.rows)):
        for number, (image, truth) in enumerate(plates(row, count, arguments.seed, arguments.device)):
            rows.append(measured_row(row, number, method.reconstruct(image), truth))
            print(json.dumps(rows[-1]), flush=True)
            if arguments.json:
                arguments.json.write_text(json.dumps({"seed": arguments.seed, "plates": rows}, indent=1) + "\n")
    print("\n".join(summary(rows)))


if __name__ == "__main__":
    main()
