"""All suites by name."""

from collections.abc import Callable
from dataclasses import dataclass

from data_gen.suites import ideal, lab, one_thing, print_shapes
from data_gen.suites.case import Case
from warp_caustics.errors import InputError, known_names


@dataclass(frozen=True)
class Suite:
    """A list of cases.

    Attributes:
        name: as given to ``--suite``.
        about: one line.
        plates: of each row.
        make: the cases with the first plates of each row, of a seed or the suite's own.
    """

    name: str
    about: str
    plates: int
    make: Callable[[int, int | None], list[Case]]


SUITES = {
    suite.name: suite
    for suite in (
        Suite("ideal", "ten development fields on the bench that methods are told", ideal.PLATES, ideal.cases),
        Suite(
            "one-thing", "one thing at a time that differs from what methods are told", one_thing.PLATES,
            one_thing.cases,
        ),
        Suite("lab", "four benches with a camera, much of which nobody said", lab.PLATES, lab.cases),
        Suite("prints", "prints of other shapes, sections and flaws", print_shapes.PLATES, print_shapes.cases),
    )
}  # fmt: skip


def find_suite(name: str) -> Suite:
    """A suite by its name.

    Raises:
        InputError: no such suite.
    """
    if name not in SUITES:
        raise InputError(f"suite {name!r} is not known; {known_names(name, SUITES)}")
    return SUITES[name]


def suite_cases(
    name: str, plates: int | None = None, rows: tuple[str, ...] = (), seed: int | None = None
) -> list[Case]:
    """Cases of a suite, row by row.

    Args:
        name: of the suite.
        plates: the first of each row; all if None.
        rows: names of rows; all if empty.
        seed: of other plates under the same differences, for what is tuned; the suite's own if None.

    Raises:
        InputError: no such suite or row, another number of plates than there are, or a seed below 0.
    """
    suite = find_suite(name)
    count = suite.plates if plates is None else plates
    if not 1 <= count <= suite.plates:
        raise InputError(f"{count} plates of each row of {name}; there are {suite.plates}, give 1 to {suite.plates}")
    if seed is not None and not 0 <= seed < 2**62:
        raise InputError(f"seed {seed} is not between 0 and 2^62")
    cases = suite.make(count, seed)
    known = dict.fromkeys(case.row for case in cases)
    for row in rows:
        if row not in known:
            raise InputError(f"suite {name} has no row {row!r}; {known_names(row, known)}")
    return [case for case in cases if not rows or case.row in rows]
