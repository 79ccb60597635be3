"""The stored figures of ``direct`` under the conditions of ``benchmarks.robustness``, and their tables.

    python -m benchmarks.stored_robustness RUN.json ...   # figures of new weights into benchmarks/robustness_h200.json
    python -m benchmarks.stored_robustness                # the tables of docs/learned.md, from the stored figures

Runs are files that ``benchmarks.robustness --json`` wrote. Of each condition, method and field they hold the error and
the shares within one and two standard uncertainties. One run of a device replaces what was stored of it; figures of
``fibres`` come from ``table.json`` of ``nsfc compare``.
"""

import json
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np

FILE = Path(__file__).with_name("robustness_h200.json")
DEVICES = {"cuda": "one H200", "cpu": "two CPU cores"}
METHODS = {
    "once": "direct:symmetries=false,refine=false",
    "symmetries": "direct:refine=false",
    "direct": "direct",
}
FIGURES = ("rmse_um", "rmse_mean_removed_um", "rmse_aligned_um", "within_one", "within_two")

DEVELOPMENT_ROWS = {
    "as simulated": "ideal",
    "red and blue 0.1 px from green, any direction": "apart-0.1",
    "0.3 px": "apart-0.3",
    "0.5 px": "apart-0.5",
    "red and blue opposite, 0.1 px": "opposite-0.1",
    "opposite, 0.3 px": "opposite-0.3",
    "scaled 0.1 % apart": "scaled-0.1",
    "all moved, 0.3 px apart, after the best move sideways": "all-apart-0.3",
    "blur of 0.5 px": "blur-0.5",
    "1 px": "blur-1",
    "2 px": "blur-2",
    "of each channel its own": "blur-own",
    "noise of 3 % where it is as bright as a flat plate": "noise-3",
    "10 %": "noise-10",
    "light 5 % uneven": "uneven-5",
    "3 % of foreign light": "ambient-3",
    "channels mixed by 5 %": "mixing-5",
    "channels unequal by 3 %": "gain-3",
    "camera: 0.3 px, 0.7 px blur, 3 % uneven, 1 % foreign, 3 % mixed, 2 % noise": "camera",
    "section: quarter cosine": "quarter",
    "squashed (cos^1.2)": "squashed",
    "parabola": "parabola",
    "Gaussian with feet": "gaussian",
    "ellipse": "ellipse",
    "lines that merge": "merge",
    "base bowed by 20 um, without the mean": "bow-20",
}
"""Rows of the first table of docs/learned.md, and the condition of each."""

OWN_ROWS = {
    "as simulated": "ideal",
    "blur of 1 px": "blur-1",
    "red and blue 0.3 px from green, opposite": "opposite-0.3",
    "0.3 px apart, blur 0.7 px, light 3 % uneven, 1 % foreign, 3 % mixed, noise 2 %": "camera",
}
"""Rows of the table of own fields."""

COUNTED = {"all-apart-0.3": "rmse_aligned_um", "bow-20": "rmse_mean_removed_um"}
"""Error that a condition's row tells, where it is not ``rmse_um``."""


def stored() -> dict[str, Any]:
    """What is in the file."""
    tree: dict[str, Any] = json.loads(FILE.read_text(encoding="utf-8"))
    return tree


def collect(tree: dict[str, Any], run: dict[str, Any]) -> None:
    """Take the figures of a run over into a tree.

    Args:
        tree: as stored; changed.
        run: of ``benchmarks.robustness --json``: figures of every field by
            ``robustness/WEIGHTS/DEVICE/SEED/PHOTONS/OPTIONS/VARIANT/CONDITION``.
    """
    for key, fields in run.items():
        _, weights, device, seed, _, options, variant, condition = key.split("/")
        if options != "default":
            raise SystemExit(f"{key}: figures of other options than the default are not stored")
        where = tree["development"] if seed == "None" else tree["own_fields"]
        found = where.setdefault(DEVICES[device], {}).setdefault(condition, {})
        found[METHODS[variant]] = {
            name: [fields[field][name] for field in sorted(fields, key=int)]
            for name in FIGURES
            if all(name in figures for figures in fields.values())
        } | {"weights": weights, "refinement": [fields[field]["refinement"] for field in sorted(fields, key=int)]}


def row(found: dict[str, Any], condition: str) -> list[str]:
    """Symmetries, ``direct``, and what its uncertainty covers, as a table prints them.

    Args:
        found: figures of each method under the condition.
        condition: its name.
    """
    which = COUNTED.get(condition, "rmse_um")
    errors = [found[method][which] for method in ("direct:refine=false", "direct")]
    cells = [f"{np.mean(values):.1f} / {np.median(values):.1f}" for values in errors]
    shares = (100 * np.mean(found["direct"][name]) for name in ("within_one", "within_two"))
    return [cells[0], f"**{cells[1]}**", ", ".join(f"{share:.0f}" for share in shares) + " %"]


def table(conditions: dict[str, Any], rows: dict[str, str]) -> list[str]:
    """Lines of a table in Markdown, without its head."""
    return [f"| {' | '.join([name, *row(conditions[condition], condition)])} |" for name, condition in rows.items()]


def main(files: list[Path]) -> None:
    """Take runs over, or print."""
    tree = stored()
    for file in files:
        collect(tree, json.loads(file.read_text(encoding="utf-8")))
    if files:
        # A list of figures is one line.
        text = re.sub(r"\[[^][{}]*\]", lambda found: " ".join(found[0].split()), json.dumps(tree, indent=1))
        FILE.write_text(text + "\n", encoding="utf-8")
    for name, rows in (("development", DEVELOPMENT_ROWS), ("own_fields", OWN_ROWS)):
        print("\n".join([name, *table(tree[name][DEVICES["cuda"]], rows), ""]))


if __name__ == "__main__":
    main([Path(name) for name in sys.argv[1:]])
