"""A design as a list of printed lines, in a CSV or YAML file.

The unit stands in the name of a column or key: start_x, start_y, end_x, end_y,
width and height, each with _m, _mm or _um, from the plate's centre. CSV has one
line of names and one row per printed line; YAML is a list of mappings with
these keys, or a mapping whose key ``lines`` holds it. Numbers are decimal, by the rules of
:mod:`warp_caustics.io.yaml_file` in both: ``010`` is ten, and ``yes``, ``1:30`` and ``1_0`` are no numbers. Nothing
may be given twice. A list that says more (sections, curves, fibres) is a design
(:mod:`warp_caustics.prints.design_file`).
"""

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from warp_caustics.errors import InputError, shortened
from warp_caustics.io.atomic import PathLike, atomic_path, reason, regular_file
from warp_caustics.io.yaml_file import MAX_YAML_BYTES, parsed_yaml
from warp_caustics.prints.design_words import number_of, word_of
from warp_caustics.prints.line import MAX_LINES, Line

QUANTITIES = ("start_x", "start_y", "end_x", "end_y", "width", "height")
UNITS_M = {"m": 1.0, "mm": 1e-3, "um": 1e-6}
SUFFIXES = (".csv", ".yaml", ".yml")
MAX_BYTES = 10_000_000
_IS_DESIGN = "is a design with {word!r}; give straight lines with a width and a height each here"


def read_lines(path: PathLike) -> list[Line]:
    """Read a list of printed lines.

    Args:
        path: .csv, .yaml or .yml.

    Returns:
        Lines in the order of the file [m].

    Raises:
        InputError: unreadable, a missing or unknown column, or a value that makes no line.
    """
    name = repr(str(path))
    rows, settings = read_rows(path)
    if settings:
        raise InputError(f"{name} {_IS_DESIGN.format(word=next(iter(settings)))}")
    return [_line(row, f"{name}, {where}") for where, row in rows]


def read_rows(path: PathLike) -> tuple[list[tuple[str, Mapping[str, Any]]], dict[str, Any]]:
    """Entries of a list of lines or a design: where each stands and what it says; and what stands beside them.

    Raises:
        InputError: unreadable, without lines, or with more than ``MAX_LINES``.
    """
    file = regular_file(path)
    name = repr(str(path))
    if file.suffix.lower() not in SUFFIXES:
        raise InputError(f"{name} is no list of lines; give {', '.join(SUFFIXES)}")
    if file.stat().st_size > MAX_BYTES:
        raise InputError(f"{name} is larger than {MAX_BYTES // 1_000_000} MB; a list of lines is not, check the file")
    try:
        text = file.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{name} is no text in UTF-8 ({reason(error)}); export it again") from error
    is_csv = file.suffix.lower() == ".csv"
    rows, settings = (_csv_rows(text, name), {}) if is_csv else _yaml_rows(text, name)
    if not rows:
        raise InputError(f"{name} holds no lines; give at least one")
    if len(rows) > MAX_LINES:
        raise InputError(f"{name} holds {len(rows)} lines, at most {MAX_LINES} are read; split the design")
    return rows, settings


def write_lines(path: PathLike, lines: Sequence[Line]) -> None:
    """Write a list of printed lines as CSV in millimetres, as :func:`read_lines` reads it; complete or not at all.

    Args:
        path: .csv.
        lines: any number.
    """
    with atomic_path(path) as temporary, open(temporary, "w", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow([f"{quantity}_mm" for quantity in QUANTITIES])
        for line in lines:
            numbers = (*line.start_m, *line.end_m, line.width_m, line.height_m)
            table.writerow([f"{1e3 * number:.5f}" for number in numbers])


def _csv_rows(text: str, name: str) -> list[tuple[str, Mapping[str, Any]]]:
    try:
        table = list(csv.reader(text.splitlines(), strict=True))
    except csv.Error as error:
        raise InputError(f"{name} is no CSV ({reason(error)}); separate values by commas") from error
    filled = [(number, row) for number, row in enumerate(table, 1) if any(cell.strip() for cell in row)]
    if not filled:
        return []
    header = [cell.strip() for cell in filled[0][1]]
    if len(header) == 1 and (other := next((mark for mark in ";\t" if mark in header[0]), None)) is not None:
        raise InputError(f"{name} separates its columns by {other!r}; use ',', and a point in numbers, as in 1.5")
    twice = next((column for column in header if header.count(column) > 1), None)
    if twice is not None:
        raise InputError(f"{name}, row {filled[0][0]}: column {twice!r} is given twice; keep one")
    rows: list[tuple[str, Mapping[str, Any]]] = []
    for number, row in filled[1:]:
        if len(row) != len(header):
            raise InputError(f"{name}, row {number} has {len(row)} values, the first row {len(header)} names; mend it")
        rows.append((f"row {number}", dict(zip(header, row, strict=True))))
    return rows


def _yaml_rows(text: str, name: str) -> tuple[list[tuple[str, Mapping[str, Any]]], dict[str, Any]]:
    if len(text) > MAX_YAML_BYTES:
        # What is read as YAML takes ten times as long as CSV, and ten times the memory.
        raise InputError(
            f"{name} has {len(text)} characters, of YAML at most {MAX_YAML_BYTES} are read; write the lines as CSV "
            f"(at most {MAX_BYTES // 1_000_000} MB), or split the design"
        )
    tree, settings = parsed_yaml(text, name), {}
    if isinstance(tree, dict) and "lines" in tree:
        settings = {key: value for key, value in tree.items() if key != "lines"}
        tree = tree["lines"]
    if tree is None:
        return [], settings
    if not isinstance(tree, list) or not all(isinstance(entry, dict) for entry in tree):
        raise InputError(f"{name} is no list of mappings; write '- {{start_x_mm: -10, start_y_mm: 0, ...}}' per line")
    return [(f"line {number}", entry) for number, entry in enumerate(tree, 1)], settings


def _line(row: Mapping[str, Any], where: str) -> Line:
    values: dict[str, float] = {}
    for column, value in row.items():
        quantity, _, unit = str(column).rpartition("_")
        if quantity not in QUANTITIES or unit not in UNITS_M:
            if word_of(str(column)) is not None:
                raise InputError(f"{where}: {_IS_DESIGN.format(word=column)}")
            raise InputError(
                f"{where}: column {shortened(str(column))!r} is not known; use {', '.join(QUANTITIES)}, each with _m, "
                "_mm or _um"
            )
        if quantity in values:
            raise InputError(f"{where}: {quantity} is given twice; keep one unit")
        number = number_of(value)
        if not math.isfinite(number):
            raise InputError(
                f"{where}: {column} is {shortened(repr(value))}, not a finite number; write for example 1.5"
            )
        values[quantity] = number * UNITS_M[unit]
    missing = [quantity for quantity in QUANTITIES if quantity not in values]
    if missing:
        raise InputError(f"{where}: {', '.join(missing)} missing; give each with a unit, as {missing[0]}_mm")
    if max(abs(value) for value in values.values()) > 1:
        raise InputError(f"{where}: a length is above 1 m; check the units in the names (_m, _mm, _um)")
    try:
        return Line(
            (values["start_x"], values["start_y"]),
            (values["end_x"], values["end_y"]),
            values["width"],
            values["height"],
        )
    except InputError as error:
        raise InputError(f"{where}: {error}") from error


def is_line_list(path: PathLike) -> bool:
    """Whether a file is a list of lines, by its suffix."""
    return Path(path).suffix.lower() in SUFFIXES
