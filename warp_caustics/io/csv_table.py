"""Tables and logs as CSV: fixed columns, whole or absent, readable after a crash."""

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from warp_caustics.errors import DamagedDataError
from warp_caustics.io.atomic import PathLike, atomic_path, reason
from warp_caustics.io.regular import read_regular

_FORMULA = ("=", "+", "-", "@", "\t", "\r")
"""With these a cell is a formula to spreadsheets, which may start programs."""


class CsvTable:
    """A CSV file (UTF-8) with a line of column names.

    Args:
        path: of the file.
        columns: names, in order.
        line_end: of each line; RFC 4180 asks for CR LF.
    """

    def __init__(self, path: PathLike, columns: Sequence[str], *, line_end: str = "\r\n") -> None:
        self.path, self.columns, self._line_end = Path(path), tuple(columns), line_end

    def write(self, rows: Iterable[Mapping[str, Any]] = ()) -> None:
        """Replace the file, complete or not at all; cells that a row leaves out are empty.

        Raises:
            ValueError: a row has a column that the table has not.
            InputError: the folder is missing or not writable.
            ResourceError: the disk is full or broken.
        """
        with atomic_path(self.path) as temporary, self._open(temporary, "w") as file:
            writer = self._writer(file)
            writer.writeheader()
            writer.writerows(map(_escaped_row, rows))

    def append(self, row: Mapping[str, Any]) -> None:
        """Add a line to a file that :meth:`write` began; a crash may cut it off.

        Raises:
            ValueError: the row has a column that the table has not.
        """
        with self._open(self.path, "a") as file:
            self._writer(file).writerow(_escaped_row(row))

    def read(self, *, is_exact: bool = False) -> list[dict[str, str]]:
        """Rows of the file by its own column names; lines with too few or too many cells were cut off and are left out.

        Args:
            is_exact: refuse a file whose columns are not those of the table.

        Raises:
            FileNotFoundError: there is none.
            DamagedDataError: it is no such table.
        """
        name = repr(str(self.path))
        try:
            text = read_regular(self.path).decode()
            reader = csv.reader(io.StringIO(text, newline=""))
            header = next(reader, [])
            rows = [dict(zip(header, map(_shown, line), strict=True)) for line in reader if len(line) == len(header)]
        except FileNotFoundError:
            raise
        except (OSError, UnicodeDecodeError, csv.Error) as error:
            raise DamagedDataError(f"{name} cannot be read ({reason(error)}); move it away") from error
        if is_exact and tuple(header) != self.columns:
            raise DamagedDataError(f"{name} has other columns than this version writes; move it away")
        return rows

    def is_own(self) -> bool:
        """Whether there is such a table; another file, or a table of other columns, is somebody else's."""
        try:
            self.read(is_exact=True)
        except (OSError, DamagedDataError):
            return False
        return True

    @staticmethod
    def _open(path: Path, mode: str) -> Any:
        # A name of a file need not be text; a table with such a name must be written all the same.
        return open(path, mode, newline="", encoding="utf-8", errors="backslashreplace")

    def _writer(self, file: Any) -> "csv.DictWriter[str]":
        return csv.DictWriter(file, self.columns, lineterminator=self._line_end)


def _escaped_row(row: Mapping[str, Any]) -> dict[str, Any]:
    return {column: escaped(value) for column, value in row.items()}


def escaped(value: Any) -> Any:
    """A cell as it is written: text that begins as a formula does gets an apostrophe in front; numbers stay."""
    if not isinstance(value, str) or not value.lstrip("'").startswith(_FORMULA) or _is_number(value):
        return value
    return f"'{value}"


def _shown(cell: str) -> str:
    """A cell as it was given."""
    return cell[1:] if cell.startswith("'") and cell.lstrip("'").startswith(_FORMULA) else cell


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
