"""Files that say where the window lies: clicked corners, clicked points, or marks to look for.

YAML with one of three keys; positions are metres from the window's centre, pixels (x, y) from the centre of the
photo's first pixel::

    corners: {-x-y: [310.2, 240.1], +x-y: [1731.0, 262.9], +x+y: [1702.4, 1655.0], -x+y: [288.8, 1629.3]}
    points: [{position_m: [-0.02, 0.01], pixel_px: [412.0, 980.5]}, ...]
    markers: [{position_m: [-0.024, -0.024], near_px: [318, 250]}, ...]

``corners`` may be a list of four pixels in the order -x-y, +x-y, +x+y, -x+y. CSV has the columns ``corner,x_px,y_px``,
or ``x_px,y_px`` with four rows in that order, or ``x_m,y_m,x_px,y_px``.
"""

import csv
import io
import os
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pydantic
from pydantic import Field, model_validator

from warp_caustics.capture.border import find_border
from warp_caustics.capture.distortion import Distortion, Points
from warp_caustics.capture.markers import find_markers
from warp_caustics.capture.registration import CORNER_SIGNS, CORNERS, Registration, fitted_registration
from warp_caustics.errors import InputError
from warp_caustics.io.atomic import read_text, regular_file
from warp_caustics.io.noise import FloatImage
from warp_caustics.io.yaml_file import MAX_YAML_BYTES, read_yaml
from warp_caustics.scene import Scene, validation_lines
from warp_caustics.strict import Finite, Strict

Pair = tuple[Finite, Finite]

EXAMPLE = "corners: {-x-y: [10, 12], +x-y: [990, 14], +x+y: [985, 991], -x+y: [8, 987]}"
CSV_COLUMNS = (("corner", "x_px", "y_px"), ("x_m", "y_m", "x_px", "y_px"), ("x_px", "y_px"))
SEARCH_SHARE = 0.03
"""Radius in which a mark is looked for, as part of the window's shortest side in the photo."""
MIN_SEARCH_PX = 12.0
"""That radius, at the least [px]."""


class KnownPoint(Strict):
    """A place on the screen that someone found in the photo."""

    position_m: Pair
    pixel_px: Pair


class Marker(Strict):
    """A round mark at a known place."""

    position_m: Pair
    near_px: Pair | None = None
    """Where it lies in the photo, roughly; without it the lit window's border tells."""


class WindowFile(Strict):
    """Where the window lies in a photo; exactly one of corners, points and markers."""

    corners: dict[str, Pair] | tuple[Pair, ...] | None = None
    points: tuple[KnownPoint, ...] | None = None
    markers: tuple[Marker, ...] | None = None
    bright: bool = False
    """Marks are brighter than their surround, not darker."""
    search_px: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None
    """How far from where they are expected marks may lie [px]."""

    @model_validator(mode="after")
    def _one_kind(self) -> "WindowFile":
        given = [name for name in ("corners", "points", "markers") if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(f"holds {' and '.join(given) or 'no points'}; give one of corners, points, markers")
        if isinstance(self.corners, dict) and set(self.corners) != set(CORNERS):
            raise ValueError(f"corners are {', '.join(self.corners)}; name them {', '.join(CORNERS)}")
        count = len(self.corners or self.points or self.markers or ())
        if count < 4 or (self.corners is not None and count != 4):
            raise ValueError(
                f"{count} {given[0]} given; four are needed{'' if self.corners is not None else ' or more'}"
            )
        return self


def read_window_file(path: str | os.PathLike[str]) -> WindowFile:
    """Corners, points or marks from a YAML or CSV file.

    Raises:
        InputError: neither, an unknown key or column, a value that is no number, or too few points.
    """
    file = regular_file(path)
    tree = _csv_tree(file) if file.suffix.lower() == ".csv" else read_yaml(file, EXAMPLE)
    try:
        return WindowFile.model_validate(tree)
    except pydantic.ValidationError as error:
        raise InputError(
            "; ".join(validation_lines(error, str(file))[:3]) + f"; write for example {EXAMPLE}"
        ) from error


def _csv_tree(file: Path) -> dict[str, Any]:
    try:
        stream = io.StringIO(read_text(file, MAX_YAML_BYTES), newline="")
        lines = (line for line in stream if line.strip() and not line.startswith("#"))
        reader = csv.DictReader(lines, skipinitialspace=True)
        columns = tuple(name.strip() for name in reader.fieldnames or ())
        reader.fieldnames = columns
        rows = list(reader)
    except csv.Error as error:
        raise InputError(f"{file} is no CSV text; give a UTF-8 file") from error
    if columns not in CSV_COLUMNS:
        known = " or ".join(",".join(names) for names in CSV_COLUMNS)
        raise InputError(f"{file} has the columns {','.join(columns)[:60]!r}; use {known}")
    pixels = [(row["x_px"], row["y_px"]) for row in rows]
    if "corner" in columns:
        names = [str(row["corner"]).strip() for row in rows]
        if len(set(names)) != len(names):
            raise InputError(f"{file} names a corner twice ({', '.join(names)}); name each once")
        return {"corners": dict(zip(names, pixels, strict=True))}
    if "x_m" in columns:
        return {
            "points": [
                {"position_m": (row["x_m"], row["y_m"]), "pixel_px": pixel}
                for row, pixel in zip(rows, pixels, strict=True)
            ]
        }
    return {"corners": pixels}


def located_window(
    source: WindowFile | None,
    brightness: FloatImage,
    scene: Scene,
    *,
    distortion: Distortion | None = None,
    mirrored: bool = False,
    turned_deg: int = 0,
) -> Registration:
    """Where the scene's window lies in a photo.

    Args:
        source: what a person knows; None to look for the border of the lit window.
        brightness: the photo to look in, shape [H, W]; the flat field is best.
        scene: gives the window's extent.
        distortion: the lens.
        mirrored: the photo shows the screen from behind.
        turned_deg: only for the border: how far the window's +x is turned from the photo's columns towards its rows,
            0, 90, 180 or 270.

    Raises:
        InputError: points, marks or border that cannot be used.
    """
    size = scene.plate_size_m
    half = np.array(size) / 2
    if source is None:
        return _by_border(brightness, scene, distortion, mirrored, turned_deg)
    if source.markers is not None:
        return _by_markers(source, brightness, scene, distortion, mirrored, turned_deg)
    if source.points is not None:
        position = np.array([point.position_m for point in source.points])
        _check_positions(position, half)
        pixels = np.array([point.pixel_px for point in source.points])
        note = f"{len(position)} points given"
    else:
        corners = source.corners or {}
        pixels = np.array([corners[name] for name in CORNERS] if isinstance(corners, dict) else corners)
        position, note = CORNER_SIGNS * half, "four corners given"
    return fitted_registration(position, pixels, size, distortion=distortion, mirrored=mirrored, notes=(note,))


def _check_positions(position_m: Points, half_m: Points) -> None:
    far = np.abs(position_m) > 2 * half_m
    if far.any():
        worst = position_m[far.any(axis=1)][0]
        hint = "; did you mean millimetres? give metres" if np.abs(worst).max() > 1 else ""
        raise InputError(
            f"position {worst[0]:g}, {worst[1]:g} m is far outside the window (+-{half_m[0]:g}, +-{half_m[1]:g} m)"
            f"{hint or '; measure from its centre'}"
        )


def _by_border(
    brightness: FloatImage, scene: Scene, distortion: Distortion | None, mirrored: bool, turned_deg: int
) -> Registration:
    border = find_border(brightness, distortion)
    turn = np.deg2rad(turned_deg)
    signs = CORNER_SIGNS * ([-1, 1] if mirrored else [1, 1])
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    shown = np.rint(signs @ rotation.T)
    # The border's corners are those of an upright photo in the order of CORNERS.
    pixels = np.array([border.corners_px[int(np.argmax((sign == CORNER_SIGNS).all(axis=1)))] for sign in shown])
    found = fitted_registration(
        CORNER_SIGNS * np.array(scene.plate_size_m) / 2,
        pixels,
        scene.plate_size_m,
        distortion=distortion,
        mirrored=mirrored,
        notes=(f"border of the lit window found, {border.rms_px:.2g} px from straight lines",),
        figures={"border_rms_px": border.rms_px, "border_kept": border.kept},
    )
    doubt = []
    if scene.emission_half_angle_rad > 0 or any(scene.screen_position_m[:2]):
        doubt.append(
            "the border of the light is taken for that of the window, which it is for collimated light and a screen "
            "centred below the plate only; give the corners in a file"
        )
    return Registration(
        found.homography, found.plate_size_m, distortion, pixels, found.figures, found.notes, tuple(doubt)
    )


def _by_markers(
    source: WindowFile,
    brightness: FloatImage,
    scene: Scene,
    distortion: Distortion | None,
    mirrored: bool,
    turned_deg: int,
) -> Registration:
    markers = source.markers or ()
    position = np.array([marker.position_m for marker in markers])
    _check_positions(position, np.array(scene.plate_size_m) / 2)
    near = [marker.near_px for marker in markers]
    known = [place for place in near if place is not None]
    if len(known) == len(near):
        places = np.array(known)
        guess = fitted_registration(position, places, scene.plate_size_m, distortion=distortion, mirrored=mirrored)
    else:
        guess = _by_border(brightness, scene, distortion, mirrored, turned_deg)
        places = guess.to_photo(position)
    corners = guess.corners_px()
    side = float(np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1).min())
    search = source.search_px or max(MIN_SEARCH_PX, SEARCH_SHARE * side)
    pixels = find_markers(brightness, places, search, source.bright)
    if len({tuple(np.rint(pixel)) for pixel in pixels}) < len(pixels):
        raise InputError("two marks were found at the same place; give near_px closer to them, or a smaller search_px")
    return fitted_registration(
        position,
        pixels,
        scene.plate_size_m,
        distortion=distortion,
        mirrored=mirrored,
        notes=(f"{len(pixels)} marks found",),
        figures={"moved_px": float(np.abs(pixels - places).max())},
    )
