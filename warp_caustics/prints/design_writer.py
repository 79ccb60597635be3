"""Printed paths as a design file, which every command reads that takes a design."""

from collections.abc import Sequence

import yaml

from warp_caustics.io.atomic import PathLike, atomic_path
from warp_caustics.prints.paths import PrintedPath

DECIMALS = 4
"""Of millimetres: a tenth of a micrometre."""


def write_paths(path: PathLike, paths: Sequence[PrintedPath]) -> None:
    """Write lines with corners and curves as YAML in millimetres, as designs are read; complete or not at all.

    Args:
        path: .yaml.
        paths: any number; the width and height of each are those of its first point, caps are not told.
    """
    lines = [
        {
            "shape": "polyline",
            "points_mm": [[round(1e3 * value, DECIMALS) for value in point] for point in one.points_m.tolist()],
            "width_mm": round(1e3 * float(one.widths_m[0]), DECIMALS),
            "height_mm": round(1e3 * float(one.heights_m[0]), DECIMALS),
            "section": one.section.kind,
            "exponent": round(one.section.exponent, 4),
        }
        for one in paths
    ]
    with atomic_path(path) as temporary, open(temporary, "w", encoding="utf-8") as file:
        yaml.safe_dump({"lines": lines}, file, default_flow_style=None, sort_keys=False, width=120)
