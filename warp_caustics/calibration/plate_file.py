"""Plates from what a person writes: ``flat``, a lens or wedge (.yaml), a height map, a printed design."""

import math
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pydantic
from pydantic import Field

from warp_caustics.calibration.plates import DESIGN, FLAT, MAP, TOLERANCES, KnownPlate, flat_plate, lens, wedge
from warp_caustics.errors import InputError
from warp_caustics.io.atomic import regular_file
from warp_caustics.io.heights import read_heights
from warp_caustics.io.yaml_file import read_yaml
from warp_caustics.prints.design_file import design_relief, is_design, read_design
from warp_caustics.prints.line import line_relief
from warp_caustics.prints.line_list import is_line_list, read_lines
from warp_caustics.prints.relief_file import read_relief
from warp_caustics.scene import validation_lines
from warp_caustics.strict import Finite, Positive, Strict

EXAMPLE = "kind: lens"


class PlateFile(Strict):
    """A lens or a wedge as a file says it. Lengths may have units, as ``100mm``."""

    kind: Literal["lens", "wedge"]
    radius_m: Positive | None = None
    """Of the lens's curved face [m]; or give its focal length and index."""
    focal_length_m: Positive | None = None
    """f of the thin lens [m]; R = (n - 1) f."""
    index: Finite | None = Field(default=None, gt=1, lt=3)
    """n that the focal length is told for."""
    diameter_m: Positive | None = None
    """Of the lens's rim [m]."""
    centre_m: tuple[Finite, Finite] = (0.0, 0.0)
    """Where the lens's axis meets the plate (x, y) [m]."""
    angle_deg: Finite | None = None
    """Between the wedge's faces [degrees]."""
    towards_deg: Finite = 0.0
    """Direction of the wedge's thick end from x towards y [degrees]."""
    tolerances: dict[str, Finite] = Field(default_factory=dict)
    """Standard deviations: height_scale, shift_x_m, shift_y_m, turn_rad."""

    def plate(self, name: str) -> KnownPlate:
        """The plate.

        Raises:
            InputError: what is missing, or excludes each other.
        """
        if self.kind == "wedge":
            if self.angle_deg is None:
                raise InputError(f"{name}: a wedge needs its angle; write angle_deg: 0.5")
            made = wedge(math.radians(self.angle_deg), math.radians(self.towards_deg), name)
            return made.with_tolerances(self.tolerances)
        if self.diameter_m is None:
            raise InputError(f"{name}: a lens needs the diameter of its rim; write diameter_m: 25mm")
        if (self.radius_m is None) == (self.focal_length_m is None):
            raise InputError(f"{name}: give one of radius_m and focal_length_m; the first is what a data sheet calls R")
        if self.radius_m is not None:
            radius_m = self.radius_m
        else:
            if self.index is None:
                raise InputError(f"{name}: focal_length_m needs the index it is told for; write index: 1.458")
            assert self.focal_length_m is not None
            radius_m = (self.index - 1) * self.focal_length_m
        return lens(radius_m, self.diameter_m, self.centre_m, name).with_tolerances(self.tolerances)


def read_plate(source: str | os.PathLike[str], tolerances: Mapping[str, float] | None = None) -> KnownPlate:
    """A plate of a file, or ``flat``.

    Args:
        source: ``flat``; YAML with ``kind: lens`` or ``kind: wedge``; a printed design or list of lines (.yaml,
        .csv); a height map
            in metres.
        tolerances: in place of the usual or the file's, by name.

    Raises:
        InputError: unreadable, or no plate.
    """
    given = dict(tolerances or {})
    if os.fspath(source) == FLAT:
        return flat_plate().with_tolerances(given)
    file = regular_file(source)
    name = file.name
    if file.suffix.lower() in (".yaml", ".yml") and (tree := _mapping(file)) is not None and "kind" in tree:
        try:
            return PlateFile.model_validate(tree).plate(name).with_tolerances(given)
        except pydantic.ValidationError as error:
            raise InputError("; ".join(validation_lines(error, str(file))[:3])) from error
    if is_line_list(file):
        return _printed(file, name).with_tolerances(given)
    read_heights(file)
    return KnownPlate(MAP, name, lambda n, size: read_relief(file, n, size, "plate"), TOLERANCES[MAP]).with_tolerances(
        given
    )


def _mapping(file: Path) -> dict[str, Any] | None:
    """Keys of a YAML file; None of a list."""
    try:
        return read_yaml(file, EXAMPLE)
    except InputError as error:
        if "no keys" in str(error):
            return None
        raise


def _printed(file: Path, name: str) -> KnownPlate:
    if is_design(file):
        design = read_design(file)
        wide_paths = hasattr(design.paths[0], "widths_m")

        def drawn(factor: float, n: int, size: tuple[float, float]) -> np.ndarray:
            paths = tuple(replace(path, widths_m=path.widths_m * factor) for path in design.paths)
            return np.asarray(design_relief(replace(design, paths=paths), n, size))

        assert wide_paths
        return KnownPlate(DESIGN, name, lambda n, size: design_relief(design, n, size), TOLERANCES[DESIGN], drawn)
    lines = read_lines(file)

    def printed(factor: float, n: int, size: tuple[float, float]) -> np.ndarray:
        return np.asarray(line_relief([replace(line, width_m=line.width_m * factor) for line in lines], n, size))

    return KnownPlate(DESIGN, name, lambda n, size: line_relief(lines, n, size), TOLERANCES[DESIGN], printed)
