"""A printed design in a file: lines of any shape with sections, fibres, passes, overlaps and a base that is not flat.

YAML: a mapping with ``lines``, a list of mappings, and with settings for all of them; CSV: a row for each straight
line. Words are those of :mod:`warp_caustics.prints.design_words`; a line's own go before the settings. A file with
nothing but straight lines of given width and height is a list of lines as before
(:mod:`warp_caustics.prints.line_list`).
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from warp_caustics.errors import InputError
from warp_caustics.height_field import cell_centres
from warp_caustics.io.atomic import PathLike
from warp_caustics.prints.chains import chains_of
from warp_caustics.prints.curves import bezier_points, meander_points, ring_points
from warp_caustics.prints.design_words import design_values, word_of
from warp_caustics.prints.fibre import cap_of_area, cap_of_width, fibre_area_m2, height_of_area, proportioned
from warp_caustics.prints.font import text_lines
from warp_caustics.prints.imperfections import POINTS_PER_WAVE, thick_ends, wavy
from warp_caustics.prints.line_list import QUANTITIES, read_rows
from warp_caustics.prints.paths import MAX, SUM, PrintedPath, paths_relief
from warp_caustics.prints.sections import (
    CrossSection,
    cap_contact_angle_rad,
    cap_proportion,
    check_contact_angle,
    named_section,
)
from warp_caustics.types import FloatArray

SIZES = ("width", "height", "fibre_diameter", "passes", "section", "contact_angle", "exponent", "reach")
FLAWS = ("waviness", "sideways", "wavelength", "end_thickness", "end_length")
BASE = ("bow", "base_wave", "base_wavelength", "base_wave_angle")
SETTINGS = (*SIZES, *FLAWS, *BASE, "merge", "seed")
LARGEST_CHANGE = 0.9
"""A line that is thinner than a tenth of itself somewhere is no line."""
MOST_BASE_M = 1e-3
SHORTEST_M = 1e-4
"""Shorter waves and ends are finer than any height map [m]."""
MOST_PIECES = 200_000
"""Straight pieces of a design, which bounds memory and time."""

Values = Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class PrintDesign:
    """What is to be printed.

    Attributes:
        paths: printed lines.
        merging: p of lines on top of each other: 1 adds them up, infinity takes the highest.
        bow_m: how much higher the base is at the middle of a side than at the centre [m].
        wave: of the base, (a, k_x, k_y): a sin(k_x x + k_y y); [m, rad/m, rad/m].
    """

    paths: tuple[PrintedPath, ...]
    merging: float = SUM
    bow_m: float = 0.0
    wave: tuple[float, float, float] = (0.0, 0.0, 0.0)


def is_design(path: PathLike) -> bool:
    """Whether a list of lines says more than straight lines of given width and height.

    Raises:
        InputError: unreadable.
    """
    rows, settings = read_rows(path)
    words = {word_of(str(key)) for _, row in rows for key in row} - {None}
    return bool(settings) or not words <= set(QUANTITIES)


def read_design(path: PathLike) -> PrintDesign:
    """Read a printed design.

    Args:
        path: .csv, .yaml or .yml.

    Raises:
        InputError: unreadable, an unknown word, a value that makes no line, or a line that overhangs.
    """
    rows, found = read_rows(path)
    name = repr(str(path))
    settings = design_values(found, name, SETTINGS)
    base = {word: settings.pop(word) for word in (*BASE, "merge", "seed") if word in settings}
    paths: list[PrintedPath] = []
    pieces = known = 0
    for number, (where, row) in enumerate(rows):
        place = f"{name}, {where}"
        try:
            paths.extend(_paths(row, settings, int(base.get("seed", 0)), number, place))
        except InputError as error:
            raise InputError(str(error) if str(error).startswith(place) else f"{place}: {error}") from error
        if (pieces := pieces + sum(len(path.points_m) for path in paths[known:])) > MOST_PIECES:
            raise InputError(f"{name} has more than {MOST_PIECES} straight pieces; split the design")
        known = len(paths)
    wave = base.get("base_wave", 0.0)
    for word in ("bow", "base_wave"):
        if abs(base.get(word, 0.0)) > MOST_BASE_M:
            raise InputError(f"{name}: {word} of {base[word] * 1e3:g} mm; give at most {MOST_BASE_M * 1e3:g} mm")
    if wave and not base.get("base_wavelength", 0.0) > 0:
        raise InputError(f"{name}: base_wave without a base_wavelength above 0; give base_wavelength_mm: 20")
    number_ = 2 * math.pi / base["base_wavelength"] if wave else 0.0
    angle = base.get("base_wave_angle", 0.0)
    return PrintDesign(
        tuple(paths),
        _merging(base.get("merge", "sum"), name),
        base.get("bow", 0.0),
        (wave, number_ * math.cos(angle), number_ * math.sin(angle)),
    )


def design_relief(
    design: PrintDesign, samples: int, plate_size_m: tuple[float, float], *, supersampling: int = 4
) -> FloatArray:
    """Heights of a design above the base's centre [m], shape [n, n]; row grows with +y, column with +x."""
    relief = paths_relief(design.paths, samples, plate_size_m, merging=design.merging, supersampling=supersampling)
    x, y = (cell_centres(samples, length) for length in plate_size_m)
    bowl = 4 * design.bow_m / max(plate_size_m) ** 2 * (x[None, :] ** 2 + y[:, None] ** 2)
    amplitude, k_x, k_y = design.wave
    return np.asarray(relief + bowl + amplitude * np.sin(k_x * x[None, :] + k_y * y[:, None]))


def _merging(value: Any, name: str) -> float:
    if value in ("sum", "max"):
        return SUM if value == "sum" else MAX
    if isinstance(value, bool) or not isinstance(value, int | float) or not 1 <= value <= 100:
        raise InputError(f"{name}: merge is {str(value)[:40]!r}; use sum, max, or a power from 1 to 100")
    return float(value)


# --------------------------------------------------------------------------- one line


def _straight(own: Values) -> list[FloatArray]:
    return [np.array([[own["start_x"], own["start_y"]], [own["end_x"], own["end_y"]]])]


def _ring(own: Values) -> list[FloatArray]:
    if not own["radius"] > 0:
        raise InputError(f"ring of radius {own['radius'] * 1e3:g} mm; give one above 0, or shape drop")
    return [ring_points(own["centre"], own["radius"])]


def _meander(own: Values) -> list[FloatArray]:
    where = own.get("centre", (0.0, 0.0))
    return [meander_points(where, own["length"], own["spacing"], own["rows"], own.get("angle", 0.0))]


def _text(own: Values) -> list[FloatArray]:
    return text_lines(own["text"], own["cap_height"], own.get("centre", (0.0, 0.0)), own.get("angle", 0.0))


@dataclass(frozen=True)
class _Shape:
    needs: tuple[str, ...]
    may_have: tuple[str, ...]
    lines: Callable[[Values], list[FloatArray]]


SHAPES: dict[str, _Shape] = {
    "line": _Shape(("start_x", "start_y", "end_x", "end_y"), (), _straight),
    "polyline": _Shape(("points",), (), lambda own: [np.array(own["points"])]),
    "bezier": _Shape(("control",), (), lambda own: [bezier_points(np.array(own["control"]))]),
    "ring": _Shape(("centre", "radius"), (), _ring),
    "drop": _Shape(("centre",), (), lambda own: [np.array([own["centre"]])]),
    "meander": _Shape(("length", "spacing", "rows"), ("centre", "angle"), _meander),
    "text": _Shape(("text", "cap_height"), ("centre", "angle"), _text),
}
"""Shapes by name: the words they need, those they may have, and their centre lines."""


def _paths(row: Values, settings: Values, seed: int, number: int, where: str) -> list[PrintedPath]:
    """Printed lines of one entry of a design; a text has several."""
    name = str(row.get("shape") or "line").strip()
    if name not in SHAPES:
        raise InputError(f"shape {name[:40]!r} is not known; use one of {', '.join(SHAPES)}")
    shape = SHAPES[name]
    own = design_values(row, where, ("shape", *shape.needs, *shape.may_have, *SIZES, *FLAWS))
    missing = [word for word in shape.needs if word not in own]
    if missing:
        raise InputError(f"{name} needs {', '.join(missing)}; give each with its unit, as {missing[0]}_mm")
    given = _own_first(own, settings)
    section, width, height = _sized(given)
    lines = shape.lines(own)
    chains = chains_of(lines, [width] * len(lines), [height] * len(lines))
    whole = np.ones(len(lines))
    for word in ("waviness", "end_thickness"):
        if not 0 <= given.get(word, 0.0) <= LARGEST_CHANGE:
            raise InputError(f"{word} {given[word]:g} of the line; give 0 to {LARGEST_CHANGE:g}, for example 0.04")
    for word in ("wavelength", "end_length"):
        if not given.get(word, 1.0) >= SHORTEST_M:
            raise InputError(f"{word} of {given[word] * 1e3:g} mm; give at least {SHORTEST_M * 1e3:g} mm")
    share, sideways = given.get("waviness", 0.0), given.get("sideways", 0.0)
    if share or sideways:
        waves = float(chains.lengths_m.sum()) / given.get("wavelength", 5e-3)
        if waves * POINTS_PER_WAVE > MOST_PIECES:
            raise InputError(f"{waves:.3g} waves along one line; give a longer wavelength")
        phases = np.random.default_rng([seed, number]).uniform(0, 2 * np.pi, (len(lines), 4))
        chains = wavy(chains, share * whole, sideways * whole, given.get("wavelength", 5e-3) * whole, phases)
    if given.get("end_thickness", 0.0):
        chains = thick_ends(chains, given["end_thickness"] * whole, given.get("end_length", 1e-3) * whole)
    return [
        PrintedPath(chains.points_m[a : b + 1], chains.widths_m[a : b + 1], chains.heights_m[a : b + 1], section)
        for a, b in zip(chains.first, chains.last, strict=True)
    ]


def _own_first(own: Values, settings: Values) -> dict[str, Any]:
    """Settings, and a line's own words in their place; of a width and an angle for one fibre the own one counts."""
    rest = dict(settings)
    for mine, other in (("width", "contact_angle"), ("contact_angle", "width")):
        if mine in own and other not in own and "fibre_diameter" in {*own, *settings}:
            rest.pop(other, None)
    return {**rest, **own}


def _sized(given: Values) -> tuple[CrossSection, float, float]:
    """Section, width and height [m] of a line, from what is given of them."""
    has = {word for word in SIZES if word in given}
    name = given.get("section", "cap" if has & {"fibre_diameter", "contact_angle"} else "cosine")
    shape = {"exponent": given.get("exponent"), "reach": given.get("reach", 1.0)}
    angle, width, height = (given.get(word) for word in ("contact_angle", "width", "height"))
    for word, value in (("width", width), ("height", height)):
        if value is not None and not value > 0:
            raise InputError(f"{word} {value * 1e3:g} mm; a printed line needs one above 0")
    if angle is not None:
        check_contact_angle(angle)
    if "fibre_diameter" in given:
        return _of_fibre(given, name, shape)
    if given.get("passes", 1) != 1:
        raise InputError(f"{given['passes']} passes of a line whose width and height are given; give fibre_diameter_mm")
    if name == "cap":
        if width is None or (angle is None) == (height is None):
            raise InputError("a cap needs a width and either a contact angle or a height; give contact_angle_deg: 60")
        if angle is None:
            assert height is not None
            angle = cap_contact_angle_rad(width, height)
            if angle > math.pi / 2:
                raise InputError(
                    f"a cap {width * 1e3:g} mm wide and {height * 1e3:g} mm high has a contact angle of "
                    f"{math.degrees(angle):.4g} degrees: it overhangs and is no height field; make it at most "
                    f"{width * 5e2:g} mm high"
                )
        return named_section("cap", contact_angle_rad=angle, **shape), width, cap_proportion(angle) * width
    if angle is not None:
        raise InputError(f"contact angle of a section {name!r} that is made of no fibre; leave it out, or use cap")
    if width is None or height is None:
        raise InputError("a line needs a width and a height, or a fibre_diameter; give width_mm and height_mm")
    return named_section(name, **shape), width, height


def _of_fibre(given: Values, name: str, shape: Mapping[str, Any]) -> tuple[CrossSection, float, float]:
    area = fibre_area_m2(given["fibre_diameter"], given.get("passes", 1))
    angle, width = given.get("contact_angle"), given.get("width")
    if "height" in given or (angle is None) == (width is None):
        raise InputError("a fibre's glass spreads by one of contact angle and width; give contact_angle_deg: 60")
    if name == "cap":
        if angle is not None:
            return named_section("cap", contact_angle_rad=angle, **shape), *cap_of_area(area, angle)
        assert width is not None
        angle, height = cap_of_width(area, width)
        return named_section("cap", contact_angle_rad=angle, **shape), width, height
    section = named_section(name, **shape)
    if angle is not None:
        return section, *proportioned(section, area, angle)
    assert width is not None
    return section, width, height_of_area(section, area, width)
